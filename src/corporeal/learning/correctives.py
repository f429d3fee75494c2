"""The step that learns pose correctives: a ridge regression at the zero pose, held local (equation 10)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from corporeal.learning import skinning_kernels as kernels
from corporeal.learning.objective import Priors, corrective_costs
from corporeal.learning.options import LearningOptions
from corporeal.learning.state import LearningState, Registrations

# Skinning hardly stretches, so that the preconditioner is nearly the inverse: three steps leave 1e-3 of the
# gradient.
_STEPS = 4
# Systems of the preconditioner inverted at once: 400 of 135 x 135 are 58 MB.
_BATCH = 400


class Preconditioner:
    """The inverse system of every vertex, made anew only where the poses are others.

    For a hand of 2,931 vertices it takes seconds to make, however few the registrations; while poses are held
    it stays the same.
    """

    def __init__(self) -> None:
        self._rotations: Float[np.ndarray, "N K 3 3"] | None = None
        self._inverse = np.empty((0, 0, 0), dtype=np.float32)

    def inverse(self, state: LearningState, costs: Float[np.ndarray, "P V"]) -> Float[np.ndarray, "V P P"]:
        """For a state, and costs that are the same in all calls."""
        if state.rotations is not self._rotations:
            self._inverse, self._rotations = _inverse_systems(state, costs), state.rotations
        return self._inverse


def fit_correctives(
    state: LearningState,
    data: Registrations,
    priors: Priors,
    options: LearningOptions,
    preconditioner: Preconditioner | None = None,
) -> LearningState:
    """Pose directions that lower the objective, by preconditioned conjugate gradients.

    Skinning turns a corrective by A, so that the exact normal equations have A^T A in them and are as large
    as all directions together (three million). Without A they fall apart into one system of 9 (K - 1) per
    vertex, the same for x, y and z: that is the preconditioner. Leaving A out altogether was refused: a step
    could then raise the objective where skinning compresses the inside of a bent finger. Calls with the same
    priors and options may share a preconditioner.
    """
    if not len(state.pose_directions):
        return state
    costs = np.repeat(corrective_costs(priors, options), 9, axis=0)
    inverse = (preconditioner or Preconditioner()).inverse(state, costs)
    P, V = costs.shape

    def metric(directions: np.ndarray) -> np.ndarray:
        return _metric(state, data, directions) + (costs[:, :, None] * directions.reshape(P, V, 3)).reshape(
            P, -1
        )

    gradient = _gradient(state, data)
    gradient -= (costs[:, :, None] * state.pose_directions.reshape(P, V, 3)).reshape(P, -1)
    step = _conjugate_gradients(metric, lambda pull: _preconditioned(inverse, pull), gradient)
    return replace(state, pose_directions=state.pose_directions + step)


def _conjugate_gradients(
    metric: Callable[[np.ndarray], np.ndarray],
    precondition: Callable[[np.ndarray], np.ndarray],
    residual: Float[np.ndarray, "P V3"],
) -> Float[np.ndarray, "P V3"]:
    solution = np.zeros_like(residual)
    direction = precondition(residual)
    product = float(np.vdot(residual, direction))
    for _ in range(_STEPS):
        if product <= 0:
            break
        moved = metric(direction)
        share = product / float(np.vdot(direction, moved))
        solution += share * direction
        residual = residual - share * moved
        preconditioned = precondition(residual)
        new_product = float(np.vdot(residual, preconditioned))
        direction = preconditioned + (new_product / product) * direction
        product = new_product
    return solution


def _gradient(state: LearningState, data: Registrations) -> Float[np.ndarray, "P V3"]:
    weights = state.weight_table()
    gradient = np.zeros_like(state.pose_directions)
    for posed in state.posed(data):
        pull = np.empty_like(posed.rest)
        kernels.unposed_pull(weights, posed.motions, posed.rest, data.vertices[posed.rows], pull)
        features = data.importance[posed.rows, None] * state.features(posed.rows)
        gradient += features.T @ pull.reshape(len(pull), -1)
    return gradient


def _metric(
    state: LearningState, data: Registrations, directions: Float[np.ndarray, "P V3"]
) -> Float[np.ndarray, "P V3"]:
    weights = state.weight_table()
    moved = np.zeros_like(directions)
    for posed in state.posed(data):
        features = state.features(posed.rows)
        offsets = (features @ directions).reshape(posed.rest.shape)
        kernels.apply_metric(weights, posed.motions, offsets)
        moved += (data.importance[posed.rows, None] * features).T @ offsets.reshape(len(offsets), -1)
    return moved


def _inverse_systems(state: LearningState, costs: Float[np.ndarray, "P V"]) -> Float[np.ndarray, "V P P"]:
    features = state.features()
    square = features.T @ features
    P, V = costs.shape
    inverse = np.empty((V, P, P), dtype=np.float32)
    # A feature that no registration moves, at a vertex on its joint, would be free.
    least = 1e-6 * max(float(np.trace(square)), 1e-12)
    for first in range(0, V, _BATCH):
        some = costs[:, first : first + _BATCH].T
        systems = np.tile(square, (len(some), 1, 1))
        systems[:, np.arange(P), np.arange(P)] += some + least
        inverse[first : first + _BATCH] = np.linalg.inv(systems)
    return inverse


def _preconditioned(
    inverse: Float[np.ndarray, "V P P"], pull: Float[np.ndarray, "P V3"]
) -> Float[np.ndarray, "P V3"]:
    P, V = len(pull), len(inverse)
    by_vertex = pull.reshape(P, V, 3).transpose(1, 0, 2).astype(np.float32)
    solved = inverse @ by_vertex
    return np.ascontiguousarray(solved.transpose(1, 0, 2), dtype=np.float64).reshape(P, 3 * V)
