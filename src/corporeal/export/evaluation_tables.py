"""An evaluation as a Markdown document: every figure with its protocol, the paper's figure and its limit."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from corporeal.atomic import write_bytes
from corporeal.export.evaluation_sections import section

# Mean s2m in the full pose space, mm, by label and protocol: Romero et al. 2017, section 5.1.
PAPER_S2M_MM = {
    ("learned", "pose only"): 0.93,
    ("learned, correctives off", "pose only"): 1.30,
    ("mirrored", "pose only"): 0.93,
    ("right only", "pose only"): 1.05,
    ("learned", "pose and shape free"): 1.01,
    ("crude start", "pose and shape free"): 2.90,
}
_UNKNOWN = "–"
# Numbers of components in the table of compactness, beside those of the paper; the plot has all.
_SHOWN = frozenset({1, 2, 3, 4, 5, 6, 8, 10, 15, 20, 30, 45})


def evaluation_markdown(results: Mapping[str, Any], title: str = "Evaluation") -> str:
    """The document; a section that the evaluation does not hold is named at its end.

    A curve of ``pose_generalisation`` and a point of ``learning_curve`` may carry ``limit`` and ``paper`` of
    their own; without a ``met`` of the evaluation an error is within its limit at or below it.

    Args:
        results: the JSON of an evaluation; the layout is that of ``corporeal.learning.evaluation.results``.
        title: the first heading.

    Raises:
        ValueError: another format, or a section that lacks what it must hold.
    """
    parts, missing = [f"# {title}"], []
    notes = [str(note) for note in results.get("notes") or ()]
    if notes:
        parts.append("\n".join(f"- {note}" for note in notes))
    parts.append(
        "Lengths are in millimetres, intervals hold 95 %. *Pose only*: a fixed personal template per hand. "
        "*Pose and shape free*: the model's own shape space is fitted too. Scan to mesh is the mean over the "
        "scans of each scan's mean distance."
    )
    for name, heading, write in (
        ("ratios", "Ratios of mean scan-to-mesh errors", _ratios),
        ("pose_generalisation", "Generalisation of the pose space: scan to mesh", _pose_generalisation),
        ("shape_generalisation", "Generalisation of the shape space: vertices", _shape_generalisation),
        ("compactness", "Compactness: share of the training set's variance", _compactness),
        ("truth", "Against the truth of the simulation", _truth),
        ("locality", "Locality of the pose correctives", _locality),
        ("learning_curve", "Learning curve: scan to mesh in the full pose space", _learning_curve),
    ):
        entries = section(results, name)
        if entries:
            parts += [f"## {heading}", *write(entries)]
        else:
            missing.append(name.replace("_", " "))
    if missing:
        parts += ["## Not measured", f"This evaluation holds nothing on: {', '.join(missing)}."]
    return "\n\n".join(parts) + "\n"


def write_evaluation_markdown(
    path: Path | str, results: Mapping[str, Any], title: str = "Evaluation"
) -> None:
    """Write the document whole or not at all.

    Raises:
        ValueError: as ``evaluation_markdown``.
        OSError: it cannot be written.
    """
    write_bytes(path, evaluation_markdown(results, title).encode())


def _ratios(entries: Sequence[Mapping[str, Any]]) -> list[str]:
    head = ("ratio", "protocol", "value", "95 %", "paper", "limit", "verdict", "subjects")
    return [
        _table(
            head,
            [
                (
                    entry["name"],
                    entry["protocol"],
                    _number(entry["value"], 3),
                    _interval(entry.get("interval")),
                    _number(entry.get("paper"), 3),
                    *_limit(entry, entry["value"], "≤"),
                    _count(entry, "n_subjects"),
                )
                for entry in entries
            ],
        )
    ]


def _pose_generalisation(entries: Sequence[Mapping[str, Any]]) -> list[str]:
    head = (
        "model",
        "protocol",
        "full pose space",
        "sd",
        "median",
        "95th percentile",
        "paper",
        "limit",
        "verdict",
        "scans",
    )
    rows = []
    for entry in entries:
        full = entry["full"]
        paper = entry.get("paper", PAPER_S2M_MM.get((entry["label"], entry["protocol"])))
        rows.append(
            (
                entry["label"],
                entry["protocol"],
                _number(full["mean"], 3),
                _number(full.get("sd"), 3),
                _number(full.get("median"), 3),
                _number(full.get("p95"), 3),
                _number(paper, 2),
                *_limit(entry, full["mean"], "≤"),
                _count(entry, "n_scans"),
            )
        )
    return [_table(head, rows), *_by_components(entries, "pose")]


def _shape_generalisation(entries: Sequence[Mapping[str, Any]]) -> list[str]:
    return _by_components(entries, "shape")


def _by_components(entries: Sequence[Mapping[str, Any]], space: str) -> list[str]:
    """Mean ± standard deviation, a row per number of components."""
    counts = sorted({count for entry in entries for count in entry["components"]})
    curves = [entry for entry in entries if entry["components"]]
    if not counts:
        return []
    head = (f"{space} components", *(f"{entry['label']} ({entry['protocol']})" for entry in curves))
    rows = [(str(count), *(_mean_and_spread(entry, count) for entry in curves)) for count in counts]
    return [
        "By number of components, mean ± standard deviation; the paper has these as a plot only:",
        _table(head, rows),
    ]


def _mean_and_spread(entry: Mapping[str, Any], count: int) -> str:
    if count not in entry["components"]:
        return _UNKNOWN
    place = list(entry["components"]).index(count)
    mean, spread = _number(entry["mean"][place], 3), _number(entry["sd"][place], 3)
    return mean if mean == _UNKNOWN else f"{mean} ± {spread}"


def _compactness(entries: Sequence[Mapping[str, Any]]) -> list[str]:
    rows = []
    for entry in entries:
        paper = entry.get("paper") or {"components": (), "shares": ()}
        published = dict(zip(paper["components"], paper["shares"], strict=True))
        for count, share in zip(entry["components"], entry["shares"], strict=True):
            if count in _SHOWN or count in published:
                rows.append(
                    (
                        entry["label"],
                        f"training set, {entry['space']} space",
                        str(count),
                        _percent(share),
                        _percent(published.get(count)),
                        "no limit",
                    )
                )
    return [_table(("model", "protocol", "components", "share", "paper", "limit"), rows)] if rows else []


def _truth(entries: Sequence[Mapping[str, Any]]) -> list[str]:
    head = (
        "model",
        "R²",
        "median",
        "worst",
        "error",
        "without correctives",
        "joint centres",
        "limit",
        "verdict",
        "scans",
    )
    rows = []
    for entry in entries:
        joints = entry.get("joint_error") or {}
        aligned = ", aligned rigidly" if entry.get("aligned") else ""
        rows.append(
            (
                f"{entry['label']}{aligned}",
                _number(entry["r_squared"], 3),
                _number(entry.get("r_squared_median"), 3),
                _number(entry.get("r_squared_worst"), 3),
                _number(entry["error"]["mean"], 3),
                _number(entry["error_without"]["mean"], 3),
                _number(joints.get("mean"), 2),
                *_limit(entry, entry["r_squared"], "≥"),
                _count(entry, "n_scans"),
            )
        )
    protocol = (
        "Protocol: *true pose and true template given*, nothing is fitted. "
        "R² = 1 - |truth - model|² / |truth - model without correctives|²; errors are means over vertices."
    )
    return [protocol, _table(head, rows)]


def _locality(entries: Sequence[Mapping[str, Any]]) -> list[str]:
    head = ("model", "protocol", "farther than", "share of corrective energy", "limit")
    rows = [
        (
            entry["label"],
            f"the model's correctives, weighting: {entry['weighting']}",
            f"{_number(entry['distance_mm'], 0)} mm",
            _percent(entry["share"]),
            "no limit",
        )
        for entry in entries
    ]
    return [_table(head, rows)]


def _learning_curve(entries: Sequence[Mapping[str, Any]]) -> list[str]:
    head = ("data", "protocol", "registrations", "mean", "95 %", "paper", "limit", "verdict", "subjects")
    rows = [
        (
            entry["label"],
            entry["protocol"],
            str(entry["n_registrations"]),
            _number(entry["mean"], 3),
            _interval(entry.get("interval")),
            _number(entry.get("paper"), 2),
            *_limit(entry, entry["mean"], "≤"),
            _count(entry, "n_subjects"),
        )
        for entry in sorted(entries, key=_place_in_curve)
    ]
    return [_table(head, rows)]


def _place_in_curve(point: Mapping[str, Any]) -> tuple[str, str, int]:
    return point["protocol"], point["label"], point["n_registrations"]


def _limit(entry: Mapping[str, Any], value: float | None, sense: str) -> tuple[str, str]:
    """The limit and the verdict."""
    limit = entry.get("limit")
    if limit is None:
        return _UNKNOWN, "no limit"
    met = entry.get("met")
    if met is None and value is not None:
        met = value <= limit if sense == "≤" else value >= limit
    # What is not known is not within its limit.
    return f"{sense} {limit:g}", "met" if met and value is not None else "not met"


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Columns of which nothing is known in any row are left out."""
    kept = [place for place in range(len(head)) if any(row[place] != _UNKNOWN for row in rows)]
    lines = [[head[place] for place in kept], ["---"] * len(kept)]
    lines += [[_escaped(row[place]) for place in kept] for row in rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _escaped(words: str) -> str:
    return words.replace("|", "\\|").replace("\n", " ")


def _number(value: float | None, digits: int) -> str:
    return _UNKNOWN if value is None or not math.isfinite(value) else f"{value:.{digits}f}"


def _percent(share: float | None) -> str:
    return _UNKNOWN if share is None or not math.isfinite(share) else f"{100 * share:.1f} %"


def _interval(interval: Sequence[float | None] | None) -> str:
    if interval is None or None in interval:
        return _UNKNOWN
    return f"{_number(interval[0], 3)} to {_number(interval[1], 3)}"


def _count(entry: Mapping[str, Any], key: str) -> str:
    return _UNKNOWN if entry.get(key) is None else str(entry[key])
