"""Points spread over a scan's surface, whatever its triangulation."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from corporeal.geometry.normals import face_areas, face_normals
from corporeal.scans.sampling import sample_points
from corporeal.scans.scan import Scan


def sample_surface(
    scan: Scan, count: int, seed: int = 0
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Positions (metres) and unit normals of points evenly spread in area, in random order.

    On a mesh exactly ``count`` points on its faces, stratified by area: coarse and fine triangles of one scan
    count alike. Of a point cloud at most ``count`` of its points. Deterministic for one seed.

    Raises:
        ValueError: ``count`` is less than 1.
    """
    generator = np.random.default_rng(seed)
    if scan.is_point_cloud:
        picked = generator.permutation(sample_points(scan.points, count, seed))
        return scan.points[picked], scan.normals[picked]
    if count < 1:
        raise ValueError(f"count: expected at least 1, got {count}")
    cumulative = np.cumsum(face_areas(scan.points, scan.faces))
    strata = (np.arange(count) + generator.random(count)) / count * cumulative[-1]
    face = generator.permutation(np.minimum(np.searchsorted(cumulative, strata), len(scan.faces) - 1))
    u, v = generator.random((2, count))
    root = np.sqrt(u)[:, None]
    a, b, c = (scan.points[scan.faces[face, corner]] for corner in range(3))
    points = (1 - root) * a + root * (1 - v[:, None]) * b + root * v[:, None] * c
    return points, face_normals(scan.points, scan.faces)[face]
