"""The machine-readable row of one scan, the same for a single scan and for a session."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from corporeal.registration.registration import Registration
    from corporeal.scans.scan import Scan


def failed_row(scan: str, reason: str, seconds: dict[str, float], notes: list[str]) -> dict[str, Any]:
    """The row of a scan that could not be registered."""
    return {
        "scan": scan,
        "status": "failed",
        "reason": reason,
        "side": None,
        "unit": None,
        "metres_per_unit": None,
        "seconds": {"total": 0.0, **seconds},
        "s2m_mm": None,
        "model_s2m_mm": None,
        "excluded": "points before the wrist plane, and points within 1 mm of the open boundary",
        "notes": notes,
        "outputs": {},
        "signals": {},
    }


def registered_row(
    scan: str, result: Registration, seconds: dict[str, float], notes: list[str]
) -> dict[str, Any]:
    """The row of a registration, whatever its status."""
    notes = [*result.scan.repairs, *notes, *result.notes, *scale_notes(result.scan)]
    stages = {f"fit: {name}": value for name, value in result.seconds.items()}
    return failed_row(scan, result.reason, seconds | stages, notes) | {
        "status": result.status,
        "signals": result.signals,
        "side": result.side,
        "unit": result.scan.unit.name,
        "metres_per_unit": result.scan.unit.metres_per_unit,
        "s2m_mm": result.distances.summary_mm(),
        "model_s2m_mm": result.model_distances.summary_mm(),
    }


def scale_notes(scan: Scan) -> list[str]:
    """What to say of a scan without a unit."""
    if scan.unit.name != "free":
        return []
    millimetres = 1e3 * scan.unit.metres_per_unit
    return [
        f"the file has no unit: one is taken as {millimetres:.4g} mm, so that the hand is as large as an "
        "average adult's; the PLYs keep the file's own unit"
    ]
