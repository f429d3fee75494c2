"""Parts of a scan that are no hand: painted objects by their colour, and what lies beyond a plane."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, UInt8

from corporeal.scans.scan import Scan


def object_mask(colours: UInt8[np.ndarray, "N 3"]) -> Bool[np.ndarray, " N"]:
    """Whether a vertex belongs to an object, objects being painted green: G > max(R, 20).

    Romero et al. 2017 (MANO), section 3.1; 8-bit red, green, blue. The rule is made for captures with painted
    objects: on others, pictures with a cold light or colours that show something else, it finds objects too.
    """
    return colours[:, 1] > np.maximum(colours[:, 0], 20)


def remove_object(scan: Scan) -> Scan:
    """The scan without the points that are green, and with a sentence that says so.

    Raises:
        ValueError: the scan has no colours, or nothing of it would be left.
    """
    if scan.colours is None:
        raise ValueError(f"{scan.name}: no colours, so that no object can be found by its colour")
    green = object_mask(scan.colours)
    if not green.any():
        return scan
    if green.all():
        raise ValueError(f"{scan.name}: every point is green (G > max(R, 20)), so that no hand would be left")
    return scan.subset(~green).with_repair(
        f"Green points of an object (G > max(R, 20)) dropped: {green.sum()}."
    )


def crop_halfspace(scan: Scan, point: Float[np.ndarray, "3"], normal: Float[np.ndarray, "3"]) -> Scan:
    """The points on the side of a plane that its normal points to; points of the plane stay.

    Args:
        scan: the scan.
        point: (3,) a point of the plane, metres, in the scan's frame.
        normal: (3,) of any length but zero, pointing to the side that is kept.

    Raises:
        ValueError: the normal is zero, or nothing would be left.
    """
    if not np.linalg.norm(normal) > 0:
        raise ValueError("normal: expected a vector of non-zero length")
    kept = (scan.points - point) @ normal >= 0
    if kept.all():
        return scan
    return scan.subset(kept).with_repair(f"Points beyond a plane dropped: {(~kept).sum()}.")
