"""Plots of an evaluation, in the manner of figures 12-14 of the MANO paper and 2-3 of its supplement."""

from __future__ import annotations

import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from corporeal.atomic import write_bytes
from corporeal.export.evaluation_sections import numbers, section

_COLOURS = ("#2b5fa8", "#c2413b", "#3a9a5b", "#d08a1e", "#7a4fa3", "#4a4d52")
_STYLE: Any = {
    "svg.hashsalt": "corporeal",
    "svg.fonttype": "none",
    "font.family": "DejaVu Sans",
    "font.size": 9.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e6e6e3",
    "axes.axisbelow": True,
    "legend.frameon": False,
}
_DOTS_PER_INCH = 150
_MAIN_LABEL = "learned"
_SHAPE_FREE = "pose and shape free"


@dataclass(frozen=True, eq=False)
class Plot:
    """A drawn figure: its name is that of its files, without the ending."""

    name: str
    figure: Figure


@dataclass(frozen=True, eq=False)
class EvaluationPlots:
    """The plots of an evaluation, and a sentence for each that could not be drawn."""

    plots: tuple[Plot, ...]
    left_out: tuple[str, ...]


def evaluation_plots(results: Mapping[str, Any]) -> EvaluationPlots:
    """Draw what the evaluation holds.

    ``compactness`` (figure 12: pose and shape side by side), ``pose_generalisation`` (figure 13: mean with a
    band of one standard deviation, full space dashed; one panel per protocol of the model called "learned"),
    ``shape_generalisation`` (figure 14), a comparison for every pair of curves that a ratio names
    (supplement, figure 2: right-only against mirrored), those of the shape-free protocol with one numerator
    together (supplement, figure 3: learned against its starts; x = 0 is the full space), ``learning_curve``.

    Args:
        results: the JSON of an evaluation; the layout is that of ``corporeal.learning.evaluation.results``.

    Raises:
        ValueError: another format, or a section that lacks what it must hold.
    """
    plots, left_out = [], []
    with mpl.rc_context(_STYLE):
        for name, draw in (
            ("compactness", _compactness),
            ("pose_generalisation", _pose_generalisation),
            ("shape_generalisation", _shape_generalisation),
            ("learning_curve", _learning_curve),
        ):
            figure = draw(section(results, name))
            if figure is None:
                left_out.append(f"{name}: the evaluation holds nothing to draw")
            else:
                plots.append(Plot(name, figure))
        compared, missing = _comparisons(results)
    return EvaluationPlots((*plots, *compared), (*left_out, *missing))


def write_evaluation_plots(folder: Path | str, results: Mapping[str, Any]) -> EvaluationPlots:
    """Write every plot as ``NAME.png`` and ``NAME.svg``; equal results give equal bytes.

    Raises:
        ValueError: as ``evaluation_plots``.
        OSError: the folder cannot be written to.
    """
    drawn = evaluation_plots(results)
    for plot in drawn.plots:
        for ending in ("png", "svg"):
            write_bytes(Path(folder) / f"{plot.name}.{ending}", plot_bytes(plot.figure, ending))
    return drawn


def plot_bytes(figure: Figure, ending: str) -> bytes:
    """The figure as "png" or "svg", without a date or the name of a program."""
    buffer = io.BytesIO()
    metadata = {"Software": None} if ending == "png" else {"Date": None, "Creator": None}
    with mpl.rc_context(_STYLE):
        figure.savefig(buffer, format=ending, dpi=_DOTS_PER_INCH, metadata=metadata)
    return buffer.getvalue()


def _compactness(curves: Sequence[Mapping[str, Any]]) -> Figure | None:
    spaces = [space for space in ("pose", "shape") if any(curve["space"] == space for curve in curves)]
    if not spaces:
        return None
    figure, panels = _panels(len(spaces))
    for panel, space in zip(panels, spaces, strict=True):
        for number, curve in enumerate(curve for curve in curves if curve["space"] == space):
            shares = 100 * np.array(numbers(curve["shares"]))
            _line(panel, curve["components"], shares, number, f"{space}:{curve['label']}", curve["label"])
            if curve.get("paper"):
                paper = curve["paper"]
                panel.plot(
                    paper["components"], 100 * np.array(numbers(paper["shares"])),
                    "o", mfc="none", mec="black", label="MANO paper", gid=f"{space}:paper",
                )  # fmt: skip
        panel.set(xlabel=f"{space} components", ylabel="explained variance, %", title=f"{space} space")
        panel.set_ylim(0, 103)
        _whole_numbers(panel)
        panel.legend(loc="lower right")
    return figure


def _pose_generalisation(curves: Sequence[Mapping[str, Any]]) -> Figure | None:
    """The model itself; other models are compared with it in figures of their own."""
    chosen = [curve for curve in curves if curve["label"] == _MAIN_LABEL] or list(curves[:1])
    if not chosen:
        return None
    figure, panels = _panels(len(chosen))
    for panel, curve in zip(panels, chosen, strict=True):
        _banded(panel, curve, 0, f"{curve['label']}:{curve['protocol']}", "mean ± sd")
        full = numbers([curve["full"]["mean"]])[0]
        panel.axhline(
            full, ls="--", lw=1.2, color="black", gid=f"full:{curve['label']}:{curve['protocol']}",
            label=f"full pose space: {full:.2f} mm",
        )  # fmt: skip
        panel.set(
            xlabel="pose components",
            ylabel="scan to mesh, mm",
            title=f"{curve['label']}, {curve['protocol']}, {curve['n_scans']} scans",
        )
        _from_zero(panel)
        _whole_numbers(panel)
        panel.legend(loc="upper right")
    return figure


def _shape_generalisation(curves: Sequence[Mapping[str, Any]]) -> Figure | None:
    if not curves:
        return None
    figure, (panel,) = _panels(1)
    for number, curve in enumerate(curves):
        _banded(panel, curve, number, f"{curve['label']}:{curve['protocol']}", f"{curve['label']}, mean ± sd")
    protocols = ", ".join(sorted({curve["protocol"] for curve in curves}))
    panel.set(xlabel="shape components", ylabel="mean absolute vertex error, mm", title=protocols)
    _from_zero(panel)
    _whole_numbers(panel)
    panel.legend(loc="upper right")
    return figure


def _learning_curve(points: Sequence[Mapping[str, Any]]) -> Figure | None:
    protocols = sorted({point["protocol"] for point in points})
    if not protocols:
        return None
    figure, panels = _panels(len(protocols))
    for panel, protocol in zip(panels, protocols, strict=True):
        of_protocol = [point for point in points if point["protocol"] == protocol]
        for number, label in enumerate(dict.fromkeys(point["label"] for point in of_protocol)):
            series = sorted(
                (point for point in of_protocol if point["label"] == label),
                key=lambda point: point["n_registrations"],
            )
            _intervals(panel, series, number)
        panel.set(
            xlabel="registrations learned from",
            ylabel="scan to mesh, mm",
            title=f"{protocol}, 95 % intervals",
        )
        panel.set_xlim(left=0)
        panel.legend(loc="upper right")
    return figure


def _comparisons(results: Mapping[str, Any]) -> tuple[list[Plot], list[str]]:
    """Plots of the curves that ratios compare, and what is said of ratios whose curves are missing."""
    curves = {(c["label"], c["protocol"]): c for c in section(results, "pose_generalisation")}
    groups: dict[tuple[str, ...], list[str]] = {}
    names: dict[tuple[str, ...], str] = {}
    left_out = []
    for ratio in section(results, "ratios"):
        protocol, numerator, denominator = ratio["protocol"], ratio["numerator"], ratio["denominator"]
        if not all((label, protocol) in curves for label in (numerator, denominator)):
            left_out.append(f"{ratio['name']}: the evaluation holds no curves of both models")
            continue
        together = (protocol, numerator) if protocol == _SHAPE_FREE else (protocol, numerator, denominator)
        labels = groups.setdefault(together, [numerator])
        labels += [denominator] if denominator not in labels else []
        names[together] = f"{numerator} against starts" if protocol == _SHAPE_FREE else ratio["name"]
    plots = [
        Plot(_file_name(names[key]), _comparison([curves[label, key[0]] for label in labels]))
        for key, labels in groups.items()
    ]
    return plots, left_out


def _comparison(curves: Sequence[Mapping[str, Any]]) -> Figure:
    figure, (panel,) = _panels(1)
    for number, curve in enumerate(curves):
        identity = f"{curve['label']}:{curve['protocol']}"
        full, spread = numbers([curve["full"]["mean"], curve["full"].get("sd")])
        label = f"{curve['label']}: {full:.2f} mm in the full space"
        colour = _COLOURS[number % len(_COLOURS)]
        _banded(panel, curve, number, identity, label)
        # Beside each other, or the bars of the full space would hide one another.
        at = 0.5 * (number - (len(curves) - 1) / 2)
        panel.errorbar([at], [full], [spread], fmt="o", ms=5, capsize=3, color=colour)
    reach = max((max(curve["components"]) for curve in curves if curve["components"]), default=1)
    ticks = [tick for tick in range(0, reach + 1, 5 if reach > 12 else 1) if tick]
    panel.set_xticks([0, *ticks], ["full", *map(str, ticks)])
    panel.set_xlim(-1.5, reach + 1)
    panel.set(xlabel="pose components", ylabel="scan to mesh, mm", title=curves[0]["protocol"])
    _from_zero(panel)
    panel.legend(loc="upper right")
    return figure


def _banded(panel: Axes, curve: Mapping[str, Any], number: int, identity: str, label: str) -> None:
    """Mean with a band of one standard deviation."""
    mean, spread = np.array(numbers(curve["mean"])), np.array(numbers(curve["sd"]))
    _line(panel, curve["components"], mean, number, identity, label)
    colour = _COLOURS[number % len(_COLOURS)]
    panel.fill_between(
        curve["components"],
        mean - spread,
        mean + spread,
        color=colour,
        alpha=0.16,
        lw=0,
        gid=f"sd:{identity}",
    )


def _intervals(panel: Axes, series: Sequence[Mapping[str, Any]], number: int) -> None:
    counts = [point["n_registrations"] for point in series]
    means = np.array(numbers([point["mean"] for point in series]))
    label = series[0]["label"]
    _line(panel, counts, means, number, f"{label}:{series[0]['protocol']}", label)
    known = [
        (c, m, p["interval"]) for c, m, p in zip(counts, means, series, strict=True) if p.get("interval")
    ]
    for count, mean, (low, high) in known:
        panel.errorbar(
            [count], [mean], [[max(mean - low, 0)], [max(high - mean, 0)]],
            fmt="none", capsize=3, lw=1.1, ecolor=_COLOURS[number % len(_COLOURS)],
        )  # fmt: skip


def _line(panel: Axes, x: Sequence[int], y: np.ndarray, number: int, identity: str, label: str) -> None:
    """The identity becomes the id of the line in an SVG."""
    colour = _COLOURS[number % len(_COLOURS)]
    panel.plot(x, y, "-o", ms=3.2, lw=1.5, color=colour, label=label, gid=f"mean:{identity}")


def _panels(count: int) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=(4.9 * count, 3.7), layout="constrained")
    FigureCanvasAgg(figure)
    return figure, [figure.add_subplot(1, count, 1 + place) for place in range(count)]


def _from_zero(panel: Axes) -> None:
    panel.set_ylim(bottom=0)


def _whole_numbers(panel: Axes) -> None:
    panel.xaxis.set_major_locator(MaxNLocator(integer=True))


def _file_name(words: str) -> str:
    return re.sub(r"[^a-z0-9]+", "_", words.lower()).strip("_")
