"""Where a scanner's points fall: evenly spread, joined to triangles, unrelated to the surface's vertices."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int
from scipy.sparse.csgraph import dijkstra

from corporeal.geometry.normals import face_areas
from corporeal.scans.simulation import scanner_kernels as kernels

# Candidates per point of the pattern: with fewer the cells are ragged.
_CANDIDATES = 7


@dataclass(frozen=True, eq=False)
class SamplingPattern:
    """Points on the faces of a surface, and triangles between them.

    Attributes:
        faces: (n,) the face of the surface that a point lies on.
        barycentric: (n, 3) and where on it.
        triangles: (m, 3) of the points.
    """

    faces: Int[np.ndarray, " n"]
    barycentric: Float[np.ndarray, "n 3"]
    triangles: Int[np.ndarray, "m 3"]

    def jittered(self, amount: float, generator: np.random.Generator) -> Float[np.ndarray, "n 3"]:
        """Barycentric weights moved at random within the faces, so that no two scans have the same points.

        Each point goes ``amount`` (0..1) of the way to a random point of its face. Noise added to weights and
        clipped was refused: it left 1 % of the points on vertices of the surface, whose places none may know.
        """
        target = generator.dirichlet(np.ones(3), size=len(self.faces))
        return self.barycentric + amount * (target - self.barycentric)

    def mirrored(self) -> SamplingPattern:
        """The pattern of the mirror image, whose faces list their corners as 0, 2, 1."""
        return SamplingPattern(self.faces, self.barycentric[:, [0, 2, 1]], self.triangles[:, [0, 2, 1]])


def sampling_pattern(
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    count: int,
    generator: np.random.Generator,
) -> SamplingPattern:
    """About ``count`` points at distances of one another, joined where their cells meet on the surface.

    The subdivided faces make a graph of many candidates; points are chosen among its nodes and
    triangles are the dual of their geodesic cells, so that neighbouring fingers are never joined.
    """
    parts = _parts_per_side(len(faces), count)
    nodes, node_faces, node_weights, small = _divided(vertices, faces, parts)
    radius = 0.78 * np.sqrt(face_areas(vertices, faces).sum() / count)
    order = generator.permutation(len(nodes))
    chosen = np.sort(kernels.spread(nodes, order, radius, *_cells(nodes, radius)))
    edges = np.concatenate([small[:, [0, 1]], small[:, [1, 2]], small[:, [2, 0]]])
    lengths = np.linalg.norm(nodes[edges[:, 0]] - nodes[edges[:, 1]], axis=1)
    graph = sp.coo_matrix((lengths, (edges[:, 0], edges[:, 1])), shape=(len(nodes),) * 2).tocsr()
    graph = graph.maximum(graph.T)
    _, _, nearest = dijkstra(graph, directed=False, indices=chosen, min_only=True, return_predecessors=True)
    corners = np.searchsorted(chosen, nearest)[small]
    a, b, c = corners.T
    dual = corners[(a != b) & (b != c) & (c != a)]
    first = dual.argmin(axis=1)[:, None]
    dual = np.unique(np.take_along_axis(dual, (first + np.arange(3)) % 3, axis=1), axis=0)
    return SamplingPattern(node_faces[chosen], node_weights[chosen], dual)


def _parts_per_side(faces: int, count: int) -> int:
    return max(1, int(np.ceil(np.sqrt(2 * _CANDIDATES * count / faces))))


def _divided(
    vertices: np.ndarray, faces: np.ndarray, parts: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Every face cut into parts x parts; nodes on shared edges are one node."""
    grid = np.array([(i, j) for i in range(parts + 1) for j in range(parts + 1 - i)])
    number = {tuple(ij): k for k, ij in enumerate(grid.tolist())}
    local = []
    for i in range(parts):
        for j in range(parts - i):
            local.append((number[i, j], number[i + 1, j], number[i, j + 1]))
            if i + j + 1 < parts:
                local.append((number[i + 1, j], number[i + 1, j + 1], number[i, j + 1]))
    weights = np.column_stack([parts - grid.sum(1), grid]) / parts
    points = np.einsum("kc,fca->fka", weights, vertices[faces]).reshape(-1, 3)
    owner = np.repeat(np.arange(len(faces)), len(grid))
    # The same node on two faces has the same coordinates up to rounding.
    _, first, same = np.unique(np.round(points, 8), axis=0, return_index=True, return_inverse=True)
    small = (np.arange(len(faces))[:, None, None] * len(grid) + np.array(local)).reshape(-1, 3)
    return points[first], owner[first], np.tile(weights, (len(faces), 1))[first], same.reshape(-1)[small]


def _cells(points: np.ndarray, size: float) -> tuple[np.ndarray, np.ndarray]:
    low = points.min(0) - 1e-9
    return low, ((points.max(0) - low) / size).astype(np.int64) + 1
