"""Histograms of the report, as SVG within the page."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence

import numpy as np

_WIDTH, _HEIGHT, _LEFT, _BOTTOM, _TOP = 640, 240, 44, 34, 10
COLOURS = {"ok": "#3a9a5b", "doubtful": "#e0a526", "failed": "#c2413b"}


def histogram_svg(values: Mapping[str, Sequence[float]], unit: str, bins: int = 40) -> str:
    """A histogram with the groups stacked; beyond the 99.5th percentile all fall into the last bin.

    Args:
        values: group -> its values, finite and not negative; groups named ok, doubtful, failed have colours.
        unit: what the axis says.
        bins: how many bars.
    """
    everything = np.concatenate(
        [np.asarray(group, dtype=float) for group in values.values()] or [np.zeros(0)]
    )
    if not len(everything):
        return "<p>nothing to draw</p>"
    limit = max(float(np.percentile(everything, 99.5)), 1e-6) * 1.001
    edges = np.linspace(0, limit, bins + 1)
    counts = {name: np.histogram(np.minimum(group, limit), edges)[0] for name, group in values.items()}
    highest = max(int(sum(counts.values()).max()), 1)  # type: ignore[union-attr]
    wide, tall = (_WIDTH - _LEFT - 8) / bins, (_HEIGHT - _BOTTOM - _TOP) / highest
    parts = [f'<svg viewBox="0 0 {_WIDTH} {_HEIGHT}" role="img" width="{_WIDTH}">']
    base = np.zeros(bins)
    for name, group in counts.items():
        for place, count in enumerate(group):
            if count:
                top = _HEIGHT - _BOTTOM - (base[place] + count) * tall
                parts.append(
                    f'<rect x="{_LEFT + place * wide:.1f}" y="{top:.1f}" width="{wide - 0.7:.1f}" '
                    f'height="{count * tall:.1f}" fill="{COLOURS.get(name, "#5a7fb0")}"/>'
                )
        base += group
    parts += _axes(limit, highest, unit)
    return "".join(parts) + "</svg>"


def _axes(limit: float, highest: int, unit: str) -> list[str]:
    bottom = _HEIGHT - _BOTTOM
    parts = [f'<line x1="{_LEFT}" x2="{_WIDTH - 8}" y1="{bottom}" y2="{bottom}" stroke="#778"/>']
    for share in np.linspace(0, 1, 6):
        x = _LEFT + share * (_WIDTH - _LEFT - 8)
        parts.append(f'<text x="{x:.0f}" y="{bottom + 14}" text-anchor="middle">{share * limit:.2f}</text>')
    parts.append(f'<text x="{_LEFT - 6}" y="{_TOP + 8}" text-anchor="end">{highest}</text>')
    middle = (_LEFT + _WIDTH) / 2
    parts.append(f'<text x="{middle}" y="{_HEIGHT - 5}" text-anchor="middle">{html.escape(unit)}</text>')
    return parts
