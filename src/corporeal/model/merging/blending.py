"""Finger weights, correctives and regressors of a hand put into a body's, faded in behind the seam."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int
from scipy.sparse.csgraph import dijkstra

from corporeal.geometry.topology import unique_edges
from corporeal.model.merging.placement import HandPlacement
from corporeal.model.merging.tree import MergedTree
from corporeal.model.surface_model import SurfaceModel


def seam_distances(body: SurfaceModel, vertices: Int[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Metres from the seam to every vertex of a hand, along the edges of the body's template.

    The seam are those vertices of the hand that have a neighbour outside. Infinite where there is none, as in
    a body that is nothing but hands.
    """
    inside = np.zeros(body.vertex_count, dtype=bool)
    inside[vertices] = True
    edges = unique_edges(body.faces)
    crossing = edges[inside[edges[:, 0]] != inside[edges[:, 1]]]
    if not len(crossing):
        return np.full(len(vertices), np.inf)
    seam = np.unique(crossing[inside[crossing]])
    own = edges[inside[edges].all(axis=1)]
    lengths = np.linalg.norm(body.template[own[:, 0]] - body.template[own[:, 1]], axis=1)
    size = (body.vertex_count, body.vertex_count)
    graph = sp.csr_matrix((np.maximum(lengths, 1e-9), (own[:, 0], own[:, 1])), shape=size)
    return dijkstra(graph, directed=False, indices=seam, min_only=True)[vertices]


def fade_in(distances: Float[np.ndarray, " n"], width: float) -> Float[np.ndarray, " n"]:
    """How much of the hand's a vertex takes: 0 at the seam, 1 from ``width`` metres behind it, smooth."""
    if width <= 0:
        return np.ones(len(distances))
    share = np.clip(distances / width, 0, 1)
    return share**2 * (3 - 2 * share)


def merged_weights(
    hand: SurfaceModel, placement: HandPlacement, tree: MergedTree, side: str,
    share: Float[np.ndarray, " n"], weights: Float[np.ndarray, "V K"],
) -> None:  # fmt: skip
    """Write the hand's finger weights into ``weights`` (in the new tree).

    What a hand's vertex gives to its root, which has the wrist and all beyond it in one, goes to the body's
    joints that are no fingers, in the proportion in which the body itself has them there; to the wrist where
    it has none.
    """
    rows = weights[placement.vertices]
    joints = tree.of_hand[side]
    others = rows.copy()
    others[:, joints[1:]] = 0
    sums = others.sum(axis=1)
    others[sums < 1e-6] = 0
    others[sums < 1e-6, joints[0]] = 1
    others /= others.sum(axis=1, keepdims=True)
    of_hand = placement.from_hand @ np.asarray(hand.skinning_weights, dtype=np.float64)
    taken = of_hand[:, :1] * others
    taken[:, joints[1:]] += of_hand[:, 1:]
    weights[placement.vertices] = (1 - share)[:, None] * rows + share[:, None] * taken


def merged_directions(
    hand: SurfaceModel, placement: HandPlacement, tree: MergedTree, side: str,
    share: Float[np.ndarray, " n"], directions: Float[np.ndarray, "V 3 P"],
) -> None:  # fmt: skip
    """Write the hand's correctives of its fingers into ``directions`` (in the new tree).

    The wrist's own stay the body's, as does what the body's fingers do to the rest of it.
    """
    columns = (9 * (tree.of_hand[side][1:, None] - 1) + np.arange(9)).ravel()
    hand_directions = np.zeros((hand.vertex_count, 3 * len(columns)))
    if hand.has_correctives:
        hand_directions[:] = hand.pose_directions.reshape(hand.vertex_count, -1)
    taken = (placement.from_hand @ hand_directions).reshape(-1, 3, len(columns))
    block = np.ix_(placement.vertices, np.arange(3), columns)
    directions[block] = (1 - share)[:, None, None] * directions[block] + share[:, None, None] * taken


def merged_regressor(
    body: SurfaceModel, hands: Mapping[str, SurfaceModel], placements: Mapping[str, HandPlacement],
    tree: MergedTree,
) -> sp.csr_matrix:  # fmt: skip
    """The body's rows; those of the fingers from the hands."""
    rows = sp.lil_matrix((len(tree.names), body.vertex_count))
    for joint in np.flatnonzero(tree.kept):
        rows[tree.of_body[joint]] = body.joint_regressor[joint]
    for side, placement in placements.items():
        moved = (hands[side].joint_regressor @ placement.from_body).tocsr()
        for k, joint in enumerate(tree.of_hand[side]):
            if k:
                rows[joint] = moved[k]
    return rows.tocsr()


def body_arrays(
    body: SurfaceModel, hand: SurfaceModel, tree: MergedTree
) -> tuple[Float[np.ndarray, "V K"], Float[np.ndarray, "V 3 P"]]:
    """The body's weights and correctives in the new tree; correctives of zero where only the hand has any."""
    V, K = body.vertex_count, len(tree.names)
    weights = np.zeros((V, K))
    np.add.at(weights.T, tree.of_body, np.asarray(body.skinning_weights, dtype=np.float64).T)
    if not (body.has_correctives or hand.has_correctives):
        return weights, np.zeros((V, 3, 0))
    directions = np.zeros((V, 3, K - 1, 9))
    if body.has_correctives:
        kept = np.flatnonzero(tree.kept)[1:]
        stored = body.pose_directions.reshape(V, 3, -1, 9)
        directions[:, :, tree.of_body[kept] - 1] = stored[:, :, kept - 1]
    return weights, directions.reshape(V, 3, 9 * (K - 1))


def strongest_weights(weights: Float[np.ndarray, "V K"], most: int) -> Float[np.ndarray, "V K"]:
    """The strongest of every vertex, made to sum to one again."""
    if most >= weights.shape[1]:
        return weights
    weakest = np.argpartition(-weights, most - 1, axis=1)[:, most:]
    kept = weights.copy()
    np.put_along_axis(kept, weakest, 0.0, axis=1)
    return kept / kept.sum(axis=1, keepdims=True)
