"""Which parts of a surface depend on which joints: a body's finger moves none of its toes.

A Jacobian of all vertices by all joints is mostly zeros, and nearly all of a solver's time goes into
multiplying by it. Groups of vertices with few joints each leave most of them out: of a body's products seven
eighths.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Int

from corporeal.model.kernel_arrays import KernelArrays

# A product with a group's slopes costs as (columns)^2 per vertex; a vertex has so many beside its joints' and
# a group costs as much as so many vertices of 50 columns, whatever its size.
_OTHER_COLUMNS, _GROUP_COST = 20, 300 * 50**2
# A model with more distinct sets of joints (of weights without a threshold, say) is one group: merging takes
# time.
_MOST_SETS = 300


@dataclass(frozen=True, eq=False)
class VertexGroup:
    """Vertices that only some joints move.

    Attributes:
        own: (n,) ascending; every vertex is some group's own, once.
        around: (m,) the own ones, then the vertices that share a face with one of them.
        joints: (j,) ascending: all that move a vertex of ``around``, by skinning or by correctives.
    """

    own: Int[np.ndarray, " n"]
    around: Int[np.ndarray, " m"]
    joints: Int[np.ndarray, " j"]


def vertex_groups(arrays: KernelArrays, faces: Int[np.ndarray, "F 3"]) -> tuple[VertexGroup, ...]:
    """Groups for which products with all vertices' slopes are cheap."""
    V, K = len(arrays.weight_starts) - 1, len(arrays.parents)
    moved = _table(arrays.chain_starts, arrays.chain_joints, K)
    moved |= _table(arrays.corrected_starts, arrays.corrected_joints, K)
    corners = np.repeat(faces, 3, axis=1).ravel(), np.tile(faces, (1, 3)).ravel()
    pairs = sp.csr_matrix((np.ones(len(corners[0]), dtype=np.int32), corners), shape=(V, V))
    neighbours = (pairs + sp.identity(V, dtype=np.int32, format="csr")).tocsr()
    involved = (neighbours @ sp.csr_matrix(moved, dtype=np.int32)).toarray() > 0
    sets, member, counts = np.unique(involved, axis=0, return_inverse=True, return_counts=True)
    merged = np.zeros(len(sets), dtype=int) if len(sets) > _MOST_SETS else _merged(sets, counts)
    of_vertex = merged[member.ravel()]
    groups = []
    for label in np.unique(merged):
        own = np.flatnonzero(of_vertex == label)
        beside = np.setdiff1d(neighbours[own].indices, own)
        joints = np.flatnonzero(sets[merged == label].any(axis=0))
        groups.append(VertexGroup(own, np.concatenate([own, beside]), joints))
    return tuple(groups)


def _table(starts: Int[np.ndarray, " V1"], joints: Int[np.ndarray, " n"], K: int) -> Bool[np.ndarray, "V K"]:
    """A sparse table of joints per vertex as a dense one."""
    table = np.zeros((len(starts) - 1, K), dtype=bool)
    table[np.repeat(np.arange(len(table)), np.diff(starts)), joints] = True
    return table


def _merged(sets: Bool[np.ndarray, "n K"], counts: Int[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
    """A label per set: the two whose union saves most become one, until no union saves anything."""
    labels = np.arange(len(sets))
    members, sizes, alive = sets.astype(float), counts.astype(float), np.ones(len(sets), dtype=bool)
    while alive.sum() > 1:
        joints = members.sum(axis=1)
        cost = sizes * (_OTHER_COLUMNS + 3 * joints) ** 2
        union = joints[:, None] + joints[None, :] - members @ members.T
        together = (sizes[:, None] + sizes[None, :]) * (_OTHER_COLUMNS + 3 * union) ** 2
        saved = cost[:, None] + cost[None, :] + _GROUP_COST - together
        saved[~alive] = saved[:, ~alive] = -np.inf
        np.fill_diagonal(saved, -np.inf)
        one, other = np.unravel_index(int(saved.argmax()), saved.shape)
        if saved[one, other] <= 0:
            break
        members[one] = np.maximum(members[one], members[other])
        sizes[one] += sizes[other]
        labels[labels == other] = one
        alive[other] = False
    return labels
