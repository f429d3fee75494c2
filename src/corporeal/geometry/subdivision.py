"""Loop subdivision as a sparse matrix: made once per topology, applied to every pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int


@dataclass(frozen=True, eq=False)
class LoopStep:
    """One step of Loop subdivision.

    Attributes:
        matrix: (V', V) rows that sum to one; the first V rows move the old vertices, the others lie on edges.
        faces: (4 F, 3) the four parts of face f are 4 f (at its first corner), 4 f + 1, 4 f + 2 and 4 f + 3
            (its middle, whose corners lie on the edges 0-1, 1-2 and 2-0).
    """

    matrix: sp.csr_matrix
    faces: Int[np.ndarray, "G 3"]

    def __call__(self, vertices: Float[np.ndarray, "V c"]) -> Float[np.ndarray, "W c"]:
        """The finer mesh's vertices, or any other values of vertices."""
        return self.matrix @ vertices


def loop_step(faces: Int[np.ndarray, "F 3"], vertex_count: int) -> LoopStep:
    """The operator of one step (Loop 1987 with Warren's weights; borders are cubic B-splines).

    Raises:
        ValueError: an edge belongs to more than two faces.
    """
    sides = faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    edges, edge_of_side, uses = np.unique(
        np.sort(sides, axis=1), axis=0, return_inverse=True, return_counts=True
    )
    edge_of_side = edge_of_side.reshape(-1)
    if (uses > 2).any():
        raise ValueError(f"faces: {int((uses > 2).sum())} edges belong to more than two faces")
    matrix = sp.vstack(
        [
            _old_vertices(edges, uses == 1, vertex_count),
            _edge_vertices(faces, edges, edge_of_side, uses, vertex_count),
        ]
    ).tocsr()
    ab, bc, ca = (vertex_count + edge_of_side.reshape(-1, 3)).T
    a, b, c = faces.T
    parts = [[a, ab, ca], [b, bc, ab], [c, ca, bc], [ab, bc, ca]]
    finer = np.stack([np.stack(part, axis=1) for part in parts], axis=1).reshape(-1, 3)
    return LoopStep(matrix, finer)


def refined_places(
    face: Int[np.ndarray, " n"], barycentric: Float[np.ndarray, "n 3"]
) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, "n 3"]]:
    """Where points given on the coarse faces lie on the finer ones, in the surface's own parameters."""
    corner = barycentric.argmax(1)
    at_corner = barycentric[np.arange(len(face)), corner] >= 0.5
    weights = np.empty_like(barycentric)
    rows = np.arange(len(face))
    # At corner k the part's own corners are k and the middles of the edges to k + 1 and to k + 2.
    following, previous = (corner + 1) % 3, (corner + 2) % 3
    weights[:, 1] = 2 * barycentric[rows, following]
    weights[:, 2] = 2 * barycentric[rows, previous]
    weights[:, 0] = 1 - weights[:, 1] - weights[:, 2]
    middle = 1 - 2 * barycentric[:, [2, 0, 1]]
    weights = np.where(at_corner[:, None], weights, middle)
    return 4 * face + np.where(at_corner, corner, 3), weights


def _old_vertices(edges: np.ndarray, border: np.ndarray, count: int) -> sp.csr_matrix:
    inner = np.concatenate([edges, edges[:, ::-1]])
    degree = np.bincount(edges.ravel(), minlength=count)
    beta = np.where(degree == 3, 3 / 16, 3 / (8 * np.maximum(degree, 1)))
    on_border = np.zeros(count, dtype=bool)
    on_border[edges[border]] = True
    own = np.where(on_border, 3 / 4, 1 - degree * beta)
    inner = inner[~on_border[inner[:, 0]]]
    rim = np.concatenate([edges[border], edges[border][:, ::-1]])
    rows = np.concatenate([np.arange(count), inner[:, 0], rim[:, 0]])
    columns = np.concatenate([np.arange(count), inner[:, 1], rim[:, 1]])
    values = np.concatenate([own, beta[inner[:, 0]], np.full(len(rim), 1 / 8)])
    return sp.csr_matrix((values, (rows, columns)), shape=(count, count))


def _edge_vertices(
    faces: np.ndarray, edges: np.ndarray, edge_of_side: np.ndarray, uses: np.ndarray, count: int
) -> sp.csr_matrix:
    ends = np.where(uses == 1, 1 / 2, 3 / 8)
    opposite = faces[:, [2, 0, 1]].reshape(-1)
    far = uses[edge_of_side] == 2
    rows = np.concatenate([np.repeat(np.arange(len(edges)), 2), edge_of_side[far]])
    columns = np.concatenate([edges.ravel(), opposite[far]])
    values = np.concatenate([np.repeat(ends, 2), np.full(int(far.sum()), 1 / 8)])
    return sp.csr_matrix((values, (rows, columns)), shape=(len(edges), count))
