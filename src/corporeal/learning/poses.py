"""The step that moves poses and places: damped Gauss-Newton on every registration by itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from corporeal.geometry.rotations_numeric import matrix_from_axis_angle, skew
from corporeal.learning import skinning_kernels as kernels
from corporeal.learning.hinges import HingePrior
from corporeal.learning.state import LearningState, Registrations

_FIRST_DAMPING = 1e-4


def fit_poses(
    state: LearningState, data: Registrations, iterations: int = 2, hinges: HingePrior | None = None
) -> LearningState:
    """Lower every registration's error by its rotations and translation; none is raised.

    The derivative of a vertex by a joint's rotation is the cross product with the part that its descendants
    carry. The correctives' own derivative is left out: it is small beside the arms, and a step that does not
    help is not taken. With ``hinges`` their prior is part of the error.
    """
    damping = np.full(len(data.hands), _FIRST_DAMPING)
    errors = _errors(state, data, hinges)
    for _ in range(iterations):
        steps = _steps(state, data, damping, hinges)
        tried = _moved(state, steps)
        new_errors = _errors(tried, data, hinges)
        better = new_errors < errors
        state = _kept(state, tried, better)
        errors = np.where(better, new_errors, errors)
        damping = np.where(better, 0.3 * damping, 30 * damping)
    return state


def _errors(state: LearningState, data: Registrations, hinges: HingePrior | None) -> Float[np.ndarray, " N"]:
    errors = state.squared_errors(data)
    return errors if hinges is None else errors + hinges.costs(state.rotations)


def _steps(
    state: LearningState, data: Registrations, damping: Float[np.ndarray, " N"], hinges: HingePrior | None
) -> Float[np.ndarray, "N Q"]:
    """Translation, then a turn of every joint in its parent's frame."""
    K, weights, chains = len(state.parents), state.weight_table(), state.chain_table()
    steps = np.empty((len(data.hands), 3 + 3 * K))
    for posed in state.posed(data):
        n = len(posed.motions)
        products, sums, turns = np.empty((n, K, K, 3, 3)), np.empty((n, K, 3)), np.empty((n, K, 3))
        pull, errors = np.empty((n, 3)), np.empty(n)
        kernels.pose_moments(
            weights, chains, state.parents, posed.motions, posed.placed, posed.rest,
            data.vertices[posed.rows], (products, sums, turns, pull, errors),
        )  # fmt: skip
        system, gradient = _equations(state, posed.motions, (products, sums, turns, pull))
        if hinges is not None:
            blocks, pulls = hinges.equations(state.rotations[posed.rows])
            gradient[:, 3:] += pulls.reshape(n, -1)
            add_joint_blocks(system, blocks)
        diagonal = np.einsum("nqq->nq", system)
        # Relative to the largest turn: a joint that moves nothing must not make the system singular.
        diagonal += damping[posed.rows, None] * (diagonal + 1e-3 * diagonal.max(axis=1, keepdims=True))
        steps[posed.rows] = np.linalg.solve(system, gradient[..., None])[..., 0]
    return steps


def _equations(
    state: LearningState, motions: Float[np.ndarray, "n K 12"], moments: tuple[np.ndarray, ...]
) -> tuple[Float[np.ndarray, "n Q Q"], Float[np.ndarray, "n Q"]]:
    """Normal equations from the moments of the arms x: blocks [x_m]^T [x_n] = (x_m . x_n) I - x_n x_m^T."""
    products, sums, turns, pull = moments
    n, K = sums.shape[:2]
    upper = np.triu_indices(K, 1)
    products[:, upper[1], upper[0]] = products[:, upper[0], upper[1]].swapaxes(-1, -2)
    traces = np.einsum("nklaa->nkl", products)
    blocks = traces[..., None, None] * np.eye(3) - products.swapaxes(-1, -2)
    spin = np.empty((n, K, 3, 3))
    spin[:, 0] = np.eye(3)
    spin[:, 1:] = motions[:, state.parents[1:], :9].reshape(n, K - 1, 3, 3)
    system = np.empty((n, 3 + 3 * K, 3 + 3 * K))
    system[:, :3, :3] = state.templates.shape[1] * np.eye(3)
    turned = np.einsum("nkca,nklcd,nldb->nkalb", spin, blocks, spin, optimize=True)
    system[:, 3:, 3:] = turned.reshape(n, 3 * K, 3 * K)
    cross = -skew(sums.reshape(-1, 3)).reshape(n, K, 3, 3) @ spin
    system[:, :3, 3:] = cross.transpose(0, 2, 1, 3).reshape(n, 3, 3 * K)
    system[:, 3:, :3] = system[:, :3, 3:].swapaxes(1, 2)
    torque = np.einsum("nkca,nkc->nka", spin, turns).reshape(n, 3 * K)
    return system, np.concatenate([pull, torque], axis=1)


def add_joint_blocks(systems: Float[np.ndarray, "n Q Q"], blocks: Float[np.ndarray, "n K 3 3"]) -> None:
    """Add a joint's block to where its turn stands in the equations of a pose: after the translation."""
    for joint in range(blocks.shape[1]):
        own = slice(3 + 3 * joint, 6 + 3 * joint)
        systems[:, own, own] += blocks[:, joint]


def _moved(state: LearningState, steps: Float[np.ndarray, "N Q"]) -> LearningState:
    N, K = state.rotations.shape[:2]
    turns = matrix_from_axis_angle(np.ascontiguousarray(steps[:, 3:]).reshape(-1, 3)).reshape(N, K, 3, 3)
    return replace(state, rotations=turns @ state.rotations, translations=state.translations + steps[:, :3])


def _kept(state: LearningState, tried: LearningState, better: Bool[np.ndarray, " N"]) -> LearningState:
    return replace(
        state,
        rotations=np.where(better[:, None, None, None], tried.rotations, state.rotations),
        translations=np.where(better[:, None], tried.translations, state.translations),
    )
