"""The mesh is its own mirror image: which vertex answers which, told from the triangles alone."""

from __future__ import annotations

from collections import deque

import numpy as np

MIRROR = np.array([-1.0, 1.0, 1.0])


def mirror_map(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(V,) mirrored vertex of every vertex; its own inverse, and every triangle is the mirror of one.

    Grown from one edge whose mirror image is plain: places alone do not tell (the source's two sides
    differ by up to 20 mm inside the mouth).

    Raises:
        ValueError: the mesh is not its own mirror image.
    """
    third = {}
    for a, b, c in faces.tolist():
        third |= {(a, b): c, (b, c): a, (c, a): b}
    start = _plain_edge(vertices, third)
    found = np.full(len(vertices), -1)
    found[list(start[0])] = start[1]
    queue, seen = deque([start[0]]), set()
    while queue:
        a, b = queue.popleft()
        if (a, b) in seen:
            continue
        seen.add((a, b))
        c, image = third[a, b], third.get((int(found[b]), int(found[a])), -1)
        if image < 0 or found[c] not in (-1, image):
            raise ValueError("the mesh is not its own mirror image")
        found[c] = image
        queue.extend(((b, c), (c, a), (b, a)))
    if (found < 0).any() or not np.array_equal(found[found], np.arange(len(vertices))):
        raise ValueError("the mesh is not its own mirror image")
    return found


def _plain_edge(vertices: np.ndarray, third: dict) -> tuple[tuple[int, int], tuple[int, int]]:
    from scipy.spatial import cKDTree

    distance, nearest = cKDTree(vertices).query(vertices * MIRROR)
    for a, b in third:
        image = int(nearest[a]), int(nearest[b])
        if distance[[a, b]].max() < 1e-5 and image[::-1] in third and abs(vertices[a, 0]) > 0.05:
            return (a, b), image
    raise ValueError("no edge has a plain mirror image")


def mirrored(points: np.ndarray, index: np.ndarray) -> np.ndarray:
    """The mirror image of (..., n, 3) points, in the order of the first side."""
    return points[..., index, :] * MIRROR
