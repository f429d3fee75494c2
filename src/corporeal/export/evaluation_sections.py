"""The sections of an evaluation's JSON, checked for what tables and plots read from them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

FORMAT = "corporeal-evaluation-1"

# What every entry of a section must hold to be shown.
_KEYS = {
    "compactness": ("label", "space", "components", "shares"),
    "pose_generalisation": ("label", "protocol", "components", "mean", "sd", "n_scans", "full"),
    "shape_generalisation": ("label", "protocol", "components", "mean", "sd"),
    "ratios": ("name", "numerator", "denominator", "protocol", "value"),
    "locality": ("label", "weighting", "distance_mm", "share"),
    "truth": ("label", "r_squared", "error", "error_without", "n_scans"),
    "learning_curve": ("label", "protocol", "n_registrations", "mean"),
}


def section(results: Mapping[str, Any], name: str) -> list[Mapping[str, Any]]:
    """The entries of a section; none where it is missing or empty.

    Raises:
        ValueError: another format, or an entry without what it must hold; the message names both.
    """
    found = results.get("format", FORMAT)
    if found != FORMAT:
        raise ValueError(f"evaluation: format {found!r}, expected {FORMAT!r}; evaluate again")
    entries = list(results.get(name) or ())
    for number, entry in enumerate(entries):
        missing = [key for key in _KEYS[name] if key not in entry]
        if missing:
            raise ValueError(f"evaluation: {name}[{number}] lacks {', '.join(missing)}")
        _check_lengths(name, number, entry)
    return entries


def numbers(values: Sequence[float | None]) -> list[float]:
    """Values with NaN for null, which stands for what is not known."""
    return [math.nan if value is None else float(value) for value in values]


def _check_lengths(name: str, number: int, entry: Mapping[str, Any]) -> None:
    count = len(entry.get("components", ()))
    for key in ("mean", "sd", "shares"):
        values = entry.get(key)
        if isinstance(values, Sequence) and len(values) != count:
            raise ValueError(
                f"evaluation: {name}[{number}].{key} has {len(values)} values for {count} components"
            )
