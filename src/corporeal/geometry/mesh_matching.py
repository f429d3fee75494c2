"""Whether one mesh is a part of another, by its triangles alone."""

from __future__ import annotations

import numpy as np
from jaxtyping import Int


def matched_from(
    part: Int[np.ndarray, "F 3"], whole: Int[np.ndarray, "G 3"], first: tuple[int, int, int]
) -> Int[np.ndarray, " n"] | None:
    """The vertices of ``whole`` that are those of ``part``, if its first triangle is where ``first`` says.

    From triangle to neighbouring triangle, over shared edges, everything else follows; nothing but winding
    and connections is used, so that the two may have any shape.

    Args:
        part: a connected, oriented manifold; every vertex 0..n-1 is in some triangle.
        whole: oriented manifold.
        first: vertices of ``whole`` for the corners of the first triangle of ``part``, in order.

    Returns:
        (n,) vertex of the whole for every vertex of the part; None where the triangles do not go on alike, or
        two vertices would be one.
    """
    beyond_part, beyond_whole = _third_corners(part), _third_corners(whole)
    found = dict(zip(part[0].tolist(), first, strict=True))
    # An edge (a, b) as its triangle runs through it; the neighbour runs through (b, a).
    open_edges = [(int(part[0][k]), int(part[0][(k + 1) % 3])) for k in range(3)]
    seen = set(open_edges)
    while open_edges:
        a, b = open_edges.pop()
        third = beyond_part.get((b, a))
        if third is None or (b, a) in seen:
            continue
        image = beyond_whole.get((found[b], found[a]))
        if image is None or found.setdefault(third, image) != image:
            return None
        for edge in ((b, a), (a, third), (third, b)):
            seen.add(edge)
        open_edges += [(a, third), (third, b)]
    count = int(part.max()) + 1
    if len(found) < count or len(set(found.values())) < count:
        return None
    return np.array([found[vertex] for vertex in range(count)], dtype=np.int64)


def _third_corners(faces: Int[np.ndarray, "F 3"]) -> dict[tuple[int, int], int]:
    """Directed edge -> the third corner of the triangle that runs through it."""
    edges = {}
    for a, b, c in faces.tolist():
        edges[a, b], edges[b, c], edges[c, a] = c, a, b
    return edges
