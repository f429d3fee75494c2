"""The step that learns skinning weights: a small quadratic programme per vertex."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int

from corporeal.learning import skinning_kernels as kernels
from corporeal.learning.objective import Priors, weight_cost
from corporeal.learning.options import LearningOptions
from corporeal.learning.state import LearningState, Registrations

MOST_JOINTS = 4
"""Joints per vertex in a file that graphics programs read."""


def fit_weights(
    state: LearningState, data: Registrations, priors: Priors, options: LearningOptions,
    candidates: Int[np.ndarray, "V C"],
) -> LearningState:  # fmt: skip
    """The best non-negative weights that sum to one, at most four per vertex, among the candidates.

    Every set of up to four candidates is tried, so that the limit of four is part of the optimum and costs
    nothing afterwards; cutting the smallest of a full solution was refused.
    """
    V, C = candidates.shape
    squares = np.zeros((V, C, C))
    for posed in state.posed(data):
        kernels.weight_moments(candidates, posed.motions, posed.rest, data.vertices[posed.rows], squares)
    lower = np.tril_indices(C, -1)
    squares[:, lower[1], lower[0]] = squares[:, lower[0], lower[1]]
    counts = (candidates >= 0).sum(axis=1)
    chosen = np.maximum(candidates, 0)
    held = np.take_along_axis(priors.weights, chosen, axis=1)
    cost = weight_cost(options)
    # The linear part stands in the column after a vertex's last candidate.
    forms = np.zeros((V, C, C + 1))
    forms[:, :, :C] = squares
    forms[:, np.arange(C), np.arange(C)] += cost
    for v in range(V):
        forms[v, : counts[v], counts[v]] = cost * held[v, : counts[v]]
    present = np.where(candidates >= 0, np.take_along_axis(state.weights, chosen, axis=1), 0.0)
    kernels.best_weights(forms, counts, MOST_JOINTS, present)
    weights = np.zeros_like(state.weights)
    rows = np.repeat(np.arange(V), counts)
    used = candidates >= 0
    weights[rows, candidates[used]] = present[used]
    return replace(state, weights=weights)


def weight_candidates(
    weights: Float[np.ndarray, "V K"], edges: Int[np.ndarray, "E 2"], rings: int = 4, most: int = 6
) -> Int[np.ndarray, "V C"]:
    """Joints that may move a vertex: those that move it or its neighbours, the strongest first; -1 for none.

    Args:
        weights: of the start model; a vertex has at most ``most`` joints.
        edges: of the template.
        rings: how far neighbours are looked for.
        most: C.
    """
    near = weights.copy()
    # A vertex's own joints stay before those of its neighbours.
    for ring in range(1, rings + 1):
        spread = near.copy()
        np.maximum.at(spread, edges[:, 0], near[edges[:, 1]])
        np.maximum.at(spread, edges[:, 1], near[edges[:, 0]])
        near = np.maximum(near, 0.1**ring * spread)
    order = np.argsort(-near, axis=1, kind="stable")[:, :most]
    return np.where(np.take_along_axis(near, order, axis=1) > 0, order, -1)
