"""Edges, boundaries, components and clean-up of triangle meshes: index arrays in, index arrays out."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float, Int
from scipy.sparse import csgraph
from scipy.spatial import cKDTree

# Vertices that may lie in one plane across x before the short way of ``weld`` is given up.
_LOOKED_AHEAD = 20


def unique_edges(faces: Int[np.ndarray, "F 3"]) -> Int[np.ndarray, "E 2"]:
    """Every edge once, the lower vertex first, in lexicographic order."""
    keys, base = _undirected_keys(_directed_edges(faces))
    unique = np.unique(keys)
    return np.stack([unique // base, unique % base], axis=1)


def boundary_edges(faces: Int[np.ndarray, "F 3"]) -> Int[np.ndarray, "E 2"]:
    """Edges of exactly one face, in that face's direction."""
    directed = _directed_edges(faces)
    keys, base = _undirected_keys(directed)
    # Few edges of a scan are open: sorting without an index and looking those up takes a third of the time.
    ordered = np.concatenate([[-1], np.sort(keys), [-1]])
    lone = ordered[1:-1][(ordered[1:-1] != ordered[:-2]) & (ordered[1:-1] != ordered[2:])]
    if not len(lone):
        return directed[:0]
    at_lone = np.zeros(base, dtype=bool)
    at_lone[lone // base] = True
    sides = np.flatnonzero(at_lone[np.minimum(*directed.T)])
    place = np.minimum(np.searchsorted(lone, keys[sides]), len(lone) - 1)
    return directed[sides[lone[place] == keys[sides]]]


def open_sides(faces: Int[np.ndarray, "F 3"]) -> Bool[np.ndarray, "F 3"]:
    """For every face and corner: is the side opposite that corner an open boundary of the mesh?"""
    open_edges = np.sort(boundary_edges(faces), axis=1)
    base = int(faces.max(initial=0)) + 1
    keys = open_edges[:, 0] * base + open_edges[:, 1]
    sides = np.empty((len(faces), 3), dtype=bool)
    for corner in range(3):
        a, b = faces[:, (corner + 1) % 3], faces[:, (corner + 2) % 3]
        sides[:, corner] = np.isin(np.minimum(a, b) * base + np.maximum(a, b), keys)
    return sides


def boundary_loops(faces: Int[np.ndarray, "F 3"]) -> list[Int[np.ndarray, " _"]]:
    """Closed chains of boundary vertices, in the direction of their faces, the longest chain first.

    No vertex occurs twice in a loop: where two holes touch at a vertex each is a loop of its own.

    Raises:
        ValueError: the boundary does not close, because faces at it have opposite windings or an edge has
            more than two faces.
    """
    edges = boundary_edges(faces)
    successors: dict[int, list[int]] = {}
    for start, end in edges.tolist():
        successors.setdefault(start, []).append(end)
    loops: list[np.ndarray] = []
    for start in list(successors):
        while successors[start]:
            loops.extend(_walk(start, successors))
    return sorted(loops, key=len, reverse=True)


def is_edge_manifold(faces: Int[np.ndarray, "F 3"]) -> bool:
    """Whether every edge has one face, or two faces that run through it in opposite directions."""
    directed = _directed_edges(faces)
    base = int(directed.max(initial=0)) + 1
    keys = directed[:, 0] * base + directed[:, 1]
    return len(np.unique(keys)) == len(keys) and not bool(np.any(directed[:, 0] == directed[:, 1]))


def face_adjacency(faces: Int[np.ndarray, "F 3"]) -> Int[np.ndarray, "A 2"]:
    """Pairs of faces that share an edge; of n faces at one edge, the n - 1 pairs that follow one another."""
    keys, _ = _undirected_keys(_directed_edges(faces))
    order = np.argsort(keys, kind="stable")
    same = keys[order[1:]] == keys[order[:-1]]
    face_of_edge = order % max(len(faces), 1)
    return np.stack([face_of_edge[:-1][same], face_of_edge[1:][same]], axis=1)


def vertex_adjacency(faces: Int[np.ndarray, "F 3"], vertex_count: int) -> sp.csr_matrix:
    """(V, V) symmetric matrix with a one for every edge."""
    edges = unique_edges(faces)
    both = np.concatenate([edges, edges[:, ::-1]])
    values = np.ones(len(both))
    return sp.csr_matrix((values, (both[:, 0], both[:, 1])), shape=(vertex_count, vertex_count))


def connected_components(faces: Int[np.ndarray, "F 3"], vertex_count: int) -> Int[np.ndarray, " V"]:
    """Label of every vertex's component: components count from 0 by falling number of faces.

    Parts that touch in a vertex are one component. A vertex without a face is a component of its own. The
    label of a face is that of any of its vertices.
    """
    # Two sides of a face connect its corners; to find every edge once takes over twice as long.
    ones = np.ones(2 * len(faces), dtype=np.int32)
    sides = (faces[:, :2].ravel(), faces[:, 1:].ravel())
    linked = sp.csr_matrix((ones, sides), shape=(vertex_count, vertex_count))
    count, labels = csgraph.connected_components(linked, directed=False)
    sizes = np.bincount(labels[faces[:, 0]], minlength=count)
    rank = np.empty(count, dtype=np.int64)
    rank[np.argsort(-sizes, kind="stable")] = np.arange(count)
    return rank[labels]


def signed_volume(vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]) -> float:
    """Enclosed volume, positive where faces are counter-clockwise seen from outside.

    An open mesh counts as closed by fans from its boundaries to the mean of its vertices, so that the sign
    still tells the winding of a hand that is open at the wrist.
    """
    used = vertices[np.unique(faces)]
    centre = used.mean(axis=0, dtype=np.float64) if len(used) else np.zeros(3)
    a, b, c = (vertices[faces[:, corner]] - centre for corner in range(3))
    return float(np.einsum("fi,fi->", a, np.cross(b, c)) / 6)


def remove_unreferenced(
    vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]
) -> tuple[Float[np.ndarray, "W 3"], Int[np.ndarray, "F 3"], Int[np.ndarray, " W"]]:
    """Drop the vertices that no face refers to.

    Returns:
        The vertices that stay, the renumbered faces, and the old index of every vertex that stays.
    """
    used = np.zeros(len(vertices), dtype=bool)
    used[faces] = True
    kept = np.flatnonzero(used)
    renumbered = np.cumsum(used) - 1
    return vertices[kept], renumbered[faces], kept


def weld(
    vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], tolerance: float
) -> tuple[Float[np.ndarray, "W 3"], Int[np.ndarray, "G 3"], Int[np.ndarray, " V"]]:
    """Merge vertices that lie within ``tolerance`` of each other, and drop the faces that collapse.

    Closeness is passed on: a chain of vertices, each within the tolerance of the next, becomes one vertex, at
    the place of its lowest index. With a tolerance of 0 only equal vertices are merged.

    Args:
        vertices: any unit; finite.
        faces: faces of a triangle soup, for instance from an STL file.
        tolerance: in the unit of the vertices, not negative.

    Returns:
        The vertices that stay, in their order; the renumbered faces; the new index of every old vertex.

    Raises:
        ValueError: the tolerance is negative or not finite, or a vertex is not finite.
    """
    if not (tolerance >= 0 and np.isfinite(tolerance)):
        raise ValueError(f"tolerance: expected a finite length of at least 0, got {tolerance}")
    if not np.isfinite(vertices).all():
        raise ValueError("vertices: some are not finite; remove them before welding")
    if _none_close(vertices, tolerance):
        return vertices, faces[has_three_corners(faces)], np.arange(len(vertices))
    # Equal vertices go first, by sorting: a soup has six of each, and the tree would list every pair of them.
    representative = _first_of_equal(vertices)
    if tolerance > 0:
        distinct = np.flatnonzero(representative == np.arange(len(vertices)))
        pairs = cKDTree(vertices[distinct]).query_pairs(tolerance, output_type="ndarray")
        graph = sp.coo_matrix((np.ones(len(pairs)), pairs.T), shape=(len(distinct), len(distinct)))
        count, labels = csgraph.connected_components(graph, directed=False)
        lowest = np.full(count, len(vertices))
        np.minimum.at(lowest, labels, distinct)
        by_vertex = np.zeros(len(vertices), dtype=np.int64)
        by_vertex[distinct] = lowest[labels]
        representative = by_vertex[representative]
    stays = representative == np.arange(len(vertices))
    new_index = (np.cumsum(stays) - 1)[representative]
    renumbered = new_index[faces]
    return vertices[stays], renumbered[has_three_corners(renumbered)], new_index


def _none_close(vertices: Float[np.ndarray, "V 3"], tolerance: float) -> bool:
    """Whether no two vertices lie within ``tolerance`` along all axes; False where too many share one plane.

    Most scans have nothing to weld: along x few vertices lie so close, and that takes a tenth of the time.
    """
    ordered = vertices[np.argsort(vertices[:, 0])]
    for step in range(1, min(_LOOKED_AHEAD, len(ordered))):
        beside = np.flatnonzero(ordered[step:, 0] - ordered[:-step, 0] <= tolerance)
        if not len(beside):
            return True
        gaps = np.abs(ordered[beside + step, 1:] - ordered[beside, 1:])
        if (np.maximum(*gaps.T) <= tolerance).any():
            return False
    return len(ordered) <= _LOOKED_AHEAD


def has_three_corners(faces: Int[np.ndarray, "F 3"]) -> Bool[np.ndarray, " F"]:
    """Whether a face names three different vertices."""
    a, b, c = faces.T
    return (a != b) & (b != c) & (c != a)


def capped_by_fans(
    vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]
) -> tuple[Float[np.ndarray, "W 3"], Int[np.ndarray, "G 3"]]:
    """Close every boundary loop by a fan of triangles to the mean of the loop's vertices.

    The added vertices and faces stand after the given ones. Raises ``ValueError`` as ``boundary_loops`` does.
    """
    centres, fans = [vertices], [faces]
    for added, loop in enumerate(boundary_loops(faces)):
        centres.append(vertices[loop].mean(axis=0, keepdims=True))
        apex = np.full(len(loop), len(vertices) + added, dtype=faces.dtype)
        fans.append(np.stack([np.roll(loop, -1), loop, apex], axis=1).astype(faces.dtype))
    return np.concatenate(centres), np.concatenate(fans)


def _directed_edges(faces: np.ndarray) -> np.ndarray:
    """(3 F, 2) edges of all faces; edge i belongs to face i % F."""
    wide = np.asarray(faces, dtype=np.int64)
    return np.concatenate([wide[:, [0, 1]], wide[:, [1, 2]], wide[:, [2, 0]]])


def _undirected_keys(edges: np.ndarray) -> tuple[np.ndarray, int]:
    """One number per undirected edge, so that a sort of numbers does for a sort of rows; and its base."""
    base = int(edges.max(initial=0)) + 1
    return np.minimum(*edges.T) * base + np.maximum(*edges.T), base


def _walk(start: int, successors: dict[int, list[int]]) -> list[np.ndarray]:
    """Follow unused edges from ``start`` until none leaves; cut off a loop wherever the path meets itself."""
    path, place, loops = [start], {start: 0}, []
    while successors.get(path[-1]):
        following = successors[path[-1]].pop()
        if following in place:
            begin = place[following]
            loops.append(np.array(path[begin:], dtype=np.int64))
            for vertex in path[begin + 1 :]:
                del place[vertex]
            del path[begin + 1 :]
        else:
            place[following] = len(path)
            path.append(following)
    if len(path) > 1:
        raise ValueError(
            f"faces: the boundary through vertex {path[-1]} does not close; faces there have opposite "
            "windings or share an edge with more than one other face"
        )
    return loops


def _first_of_equal(vertices: np.ndarray) -> np.ndarray:
    """Index of the first vertex at the same place, for every vertex."""
    order = np.lexsort(vertices.T)  # stable: of equal vertices the lowest index comes first
    ordered = vertices[order]
    begins = np.ones(len(vertices), dtype=bool)
    begins[1:] = np.any(ordered[1:] != ordered[:-1], axis=1)
    first = np.empty(len(vertices), dtype=np.int64)
    first[order] = order[begins][np.cumsum(begins) - 1]
    return first
