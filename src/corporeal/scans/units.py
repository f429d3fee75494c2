"""Which unit a scan's numbers are in, told from the size that the subject must have."""

from __future__ import annotations

from typing import Literal

import numpy as np
from jaxtyping import Float

from corporeal.scans.scan import Unit, UnitName

UnitChoice = Literal["auto", "m", "cm", "mm", "free"]
Extent = tuple[float, float]

METRES_PER_UNIT: dict[UnitName, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001}

HAND_EXTENT: Extent = (0.08, 0.9)
"""Metres: diagonal of the box about an adult's hand, from a part of a fist to a hand with its forearm."""

BODY_EXTENT: Extent = (0.25, 2.8)
"""The same for a person, from a head or a bust to a tall one with the arms stretched out."""

HEAD_EXTENT: Extent = (0.2, 0.9)
"""The same for a head, from a face to a bust with shoulders."""

ANY_EXTENT: Extent = (1e-3, 1e3)
"""For files whose unit is known already: nothing is asked of their size."""


_TOLD_MARGIN = 1.5
"""A unit that the user names is believed this far beyond the expected size: less than a wrong one errs."""


class UnitError(ValueError):
    """The unit cannot be told from the size of the scan, or the one that was told is wrong."""


def guess_unit(points: Float[np.ndarray, "N 3"], expected_extent: Extent = HAND_EXTENT) -> Unit:
    """The one unit of m, cm and mm in which the scan has the size that is expected.

    Units lie a factor of ten apart. The range for a hand spans a factor of eleven: only numbers between 80
    and 90 fit two units (cm and mm).

    Args:
        points: in the file's unit, cleaned; one stray point would decide otherwise.
        expected_extent: least and greatest length of the diagonal of the bounding box, metres.

    Raises:
        UnitError: no unit fits, or more than one.
    """
    diagonal = _diagonal(points)
    low, high = expected_extent
    fitting = [name for name, scale in METRES_PER_UNIT.items() if low <= diagonal * scale <= high]
    if len(fitting) == 1:
        return known_unit(fitting[0])
    trouble = f"fits {' and '.join(fitting)}" if fitting else "fits none of m, cm and mm"
    raise UnitError(
        f"the unit cannot be told: a diagonal of {diagonal:.4g} {trouble} for a subject of {low:g} to "
        f"{high:g} m; give --unit m, cm or mm, or --unit free if the file has no unit"
    )


def known_unit(name: UnitName) -> Unit:
    """The unit of that name; ``ValueError`` for "free", which has no fixed length."""
    if name not in METRES_PER_UNIT:
        raise ValueError(f"unit: expected one of {', '.join(METRES_PER_UNIT)}, got {name!r}")
    return Unit(name, METRES_PER_UNIT[name])


def free_unit(points: Float[np.ndarray, "N 3"], expected_extent: Extent = HAND_EXTENT) -> Unit:
    """A provisional scale that gives the diagonal the middle (geometric mean) of the expected size.

    Right to about a factor of two for hands; the fit estimates the scale and replaces it
    (``Scan.with_scale``).
    """
    low, high = expected_extent
    return Unit("free", float(np.sqrt(low * high)) / _diagonal(points))


def resolve_unit(
    points: Float[np.ndarray, "N 3"], choice: UnitChoice, expected_extent: Extent = HAND_EXTENT
) -> tuple[Unit, tuple[str, ...]]:
    """The unit that was asked for, and sentences on what was guessed or looks wrong.

    Raises:
        UnitError: "auto", and the size does not decide; or the subject would have an impossible size in the
            unit that was told.
    """
    diagonal = _diagonal(points)
    if choice == "auto":
        unit = guess_unit(points, expected_extent)
        return unit, (f"Unit guessed: {unit.name} (diagonal {diagonal:.4g}).",)
    if choice == "free":
        unit = free_unit(points, expected_extent)
        return unit, (f"No unit: the scale of {unit.metres_per_unit:.4g} m per unit is provisional.",)
    unit = known_unit(choice)
    _check_told(diagonal, unit, expected_extent)
    return unit, ()


def _check_told(diagonal: float, unit: Unit, expected_extent: Extent) -> None:
    low, high = expected_extent
    size = diagonal * unit.metres_per_unit
    if low / _TOLD_MARGIN <= size <= high * _TOLD_MARGIN:
        return
    likely = [name for name, scale in METRES_PER_UNIT.items() if low <= diagonal * scale <= high]
    advice = (
        f"it is likely in {' or '.join(likely)}: give --unit {likely[0]}" if likely else "give --unit free"
    )
    raise UnitError(
        f"--unit {unit.name}: the diagonal of {diagonal:.4g} {unit.name} is {size:.4g} m, expected "
        f"{low:g} to {high:g} m; {advice}"
    )


def _diagonal(points: np.ndarray) -> float:
    diagonal = float(np.linalg.norm(np.ptp(points, axis=0))) if len(points) else 0.0
    if not (np.isfinite(diagonal) and diagonal > 0):
        raise UnitError("the points have no extent: all lie in one place")
    return diagonal
