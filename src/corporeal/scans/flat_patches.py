"""Where a scan was cut flat or stands on a table: faces that no skin was measured on."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool

from corporeal.geometry.normals import face_areas, face_normals
from corporeal.scans.scan import Scan

_COSINE = np.cos(np.deg2rad(2.0))
_THICKNESS = 2e-3
_CANDIDATES, _RANKED = 200, 4000
# The flattest part of the real whole hands is the end of an arm with 6 % of the area; the cut of the partial
# one holds 30 %.
_LEAST_SHARE, _LARGEST_SHARE = 0.10, 0.70


def flat_patch(scan: Scan) -> Bool[np.ndarray, " M"]:
    """Faces of the largest plane of a scan, if it is larger than anything on a hand is; else none.

    A face belongs to a plane when its normal is within 2 degrees of it and its middle within 0.2 % of the
    scan's diagonal. Candidate planes are those of faces taken evenly over the area.
    """
    count = len(scan.faces)
    if count == 0:
        return np.zeros(0, dtype=bool)
    areas = face_areas(scan.points, scan.faces)
    normals = face_normals(scan.points, scan.faces)
    middles = scan.points[scan.faces].mean(axis=1)
    tolerance = _THICKNESS * scan.diagonal
    # Candidates are ranked on faces that stand for equal areas: on 80,000 faces that saves half a second.
    strata = (np.arange(_RANKED) + 0.5) / _RANKED * areas.sum()
    ranked = np.minimum(np.searchsorted(np.cumsum(areas), strata), count - 1)
    candidates = ranked[:: _RANKED // _CANDIDATES]
    turned = normals[ranked] @ normals[candidates].T
    heights = middles[ranked] @ normals[candidates].T
    heights -= np.einsum("ca,ca->c", middles[candidates], normals[candidates])
    counts = ((turned > _COSINE) & (np.abs(heights) < tolerance)).sum(axis=0)
    winner = candidates[int(np.argmax(counts))]
    best = _on_plane(normals, middles, normals[winner], middles[winner], tolerance)
    share = areas[best].sum() / areas.sum()
    # A scan that is nearly all plane is no hand at all: that is for the fit to find out, not to hide here.
    return best if _LEAST_SHARE < share < _LARGEST_SHARE else np.zeros(count, dtype=bool)


def _on_plane(
    normals: np.ndarray, middles: np.ndarray, normal: np.ndarray, middle: np.ndarray, tolerance: float
) -> Bool[np.ndarray, " n"]:
    return (normals @ normal > _COSINE) & (np.abs((middles - middle) @ normal) < tolerance)
