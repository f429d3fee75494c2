"""Coarser copies of meshes by vertex clustering, for pictures and searches that need no detail."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from corporeal.geometry.normals import face_areas
from corporeal.geometry.topology import has_three_corners

_MOST_STEPS = 4


def clustered(
    vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], count: int
) -> tuple[Float[np.ndarray, "W 3"], Int[np.ndarray, "G 3"]]:
    """About ``count`` vertices: those of one cube become one, at their mean (Rossignac and Borrel 1993).

    The mean also takes noise off. Sheets closer than a cube's side (a few millimetres on a hand of 12,000)
    may grow together: the result is for looking and searching, not for measuring. It is given back
    unchanged where it has few enough vertices already; the count is met within a quarter.

    Args:
        vertices: any unit; finite.
        faces: corner indices.
        count: how many vertices are wanted, at least 1.

    Raises:
        ValueError: ``count`` is less than 1.
    """
    if count < 1:
        raise ValueError(f"count: expected at least 1, got {count}")
    if len(vertices) <= 1.25 * count or len(faces) == 0:
        return vertices, faces
    low = vertices.min(axis=0)
    # A surface passes through about 1.5 cubes per square of their side.
    side = float(np.sqrt(1.5 * face_areas(vertices, faces).sum() / count))
    side = side if side > 0 else float(np.ptp(vertices, axis=0).max())
    for _ in range(_MOST_STEPS):
        first, cube = _cubes(vertices - low, side)
        if 0.8 * count <= len(first) <= 1.25 * count:
            break
        side *= float(np.sqrt(len(first) / count))
    members = np.bincount(cube)
    means = np.stack([np.bincount(cube, vertices[:, a]) / members for a in range(3)], axis=1)
    corners = cube[faces]
    return means, corners[has_three_corners(corners)]


def _cubes(relative: np.ndarray, side: float) -> tuple[np.ndarray, np.ndarray]:
    """First vertex of every occupied cube, and the cube of every vertex."""
    place = (relative / max(side, 1e-300)).astype(np.int64)
    extent = place.max(axis=0) + 1
    keys = (place[:, 0] * extent[1] + place[:, 1]) * extent[2] + place[:, 2]
    _, first, cube = np.unique(keys, return_index=True, return_inverse=True)
    return first, cube.ravel()
