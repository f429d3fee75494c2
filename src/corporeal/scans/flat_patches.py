"""Where a scan was cut flat or stands on a table: faces that no skin was measured on."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool

from corporeal.geometry.normals import face_areas, face_normals
from corporeal.scans.scan import Scan

_COSINE = np.cos(np.deg2rad(2.0))
_THICKNESS = 2e-3
_CANDIDATES = 200
# The flattest part of the real whole hands is the end of an arm with 6 % of the area; the cut of the partial
# one holds 30 %.
_LEAST_SHARE = 0.10


def flat_patch(scan: Scan) -> Bool[np.ndarray, " M"]:
    """Faces of the largest plane of a scan, if it is larger than anything on a hand is; else none.

    A face belongs to a plane when its normal is within 2 degrees of it and its middle within 0.2 % of the
    scan's diagonal. Candidate planes are those of the largest faces and of faces taken evenly.
    """
    count = len(scan.faces)
    if count == 0:
        return np.zeros(0, dtype=bool)
    areas = face_areas(scan.points, scan.faces)
    normals = face_normals(scan.points, scan.faces)
    middles = scan.points[scan.faces].mean(axis=1)
    largest = np.argsort(-areas, kind="stable")[: _CANDIDATES // 2]
    evenly = np.linspace(0, count - 1, _CANDIDATES // 2).astype(np.int64)
    best = np.zeros(count, dtype=bool)
    for candidate in np.concatenate([largest, evenly]):
        alike = normals @ normals[candidate] > _COSINE
        height = (middles - middles[candidate]) @ normals[candidate]
        plane = alike & (np.abs(height) < _THICKNESS * scan.diagonal)
        if areas[plane].sum() > areas[best].sum():
            best = plane
    large = areas[best].sum() > _LEAST_SHARE * areas.sum()
    return best if large else np.zeros(count, dtype=bool)
