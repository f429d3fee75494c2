"""A hand's joints, poses and the nearly rigid parts of its template, all at once.

One after the other they creep: a joint that lies wrong is made up for by poses and by templates, and each
step alone finds little to mend. Of six simulated hands whose true surfaces were given, joints were 3.4 mm off
after 30 passes and still 3.4 after 60; Gauss-Newton over everything coupled is done in eight steps.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import scipy.linalg as sl
from jaxtyping import Float, Int

from corporeal.geometry.rotations_numeric import matrix_from_axis_angle, skew
from corporeal.learning import skinning_kernels as kernels
from corporeal.learning.hinges import HingePrior
from corporeal.learning.objective import Priors
from corporeal.learning.poses import add_joint_blocks
from corporeal.learning.state import LearningState, Registrations
from corporeal.learning.templates import block_diagonal
from corporeal.model.joint_regressor import joints_below

# Observations per vertex that hold the template: with learning's own 0.5 joints are drawn 1 mm towards the
# start model's.
_TEMPLATE_STRENGTH = 0.02
# Square metres per square radian that hold the patch of a bone from turning in the template. Poses could turn
# back whatever it turns: nothing else tells the zero pose, and a thumb's turned by 40 degrees.
_PATCH_STRENGTH = 1.0
_STEPS = 8
_SETTLED = 1e-3
_FIRST_DAMPING, _EASIER, _HARDER = 1e-4, 0.3, 30.0


@dataclass(frozen=True, eq=False)
class _Hand:
    """The variables: template (V, 3), joints (K, 3), rotations (N, K, 3, 3), translations (N, 3)."""

    template: Float[np.ndarray, "V 3"]
    joints: Float[np.ndarray, "K 3"]
    rotations: Float[np.ndarray, "N K 3 3"]
    translations: Float[np.ndarray, "N 3"]


@dataclass(frozen=True, eq=False)
class _Rig:
    """Weights, what a joint carries of a vertex with all below it, which joints are below which, the tree."""

    weights: Float[np.ndarray, "V K"]
    carried: Float[np.ndarray, "V K"]
    below: Float[np.ndarray, "K K"]
    parents: Int[np.ndarray, " K"]


@dataclass(frozen=True, eq=False)
class _Held:
    """The registered vertices, and what holds the variables."""

    vertices: Float[np.ndarray, "N V 3"]
    template: Float[np.ndarray, "V 3"]
    patches: Float[np.ndarray, "B3 V3"]
    joints: Float[np.ndarray, "K 3"]
    joint_strengths: Float[np.ndarray, "K 3 3"]
    hinges: HingePrior | None


class _Linear(NamedTuple):
    """Residuals, and how vertices move: with translation and turns, with the template, with the joints."""

    residuals: Float[np.ndarray, "N V 3"]
    turns: Float[np.ndarray, "N V 3 Q"]
    blended: Float[np.ndarray, "N V 3 3"]
    levers: Float[np.ndarray, "N K 3 3"]
    moves: Float[np.ndarray, "N V 3 K3"]


class _Poses(NamedTuple):
    """The poses' equations, eliminated: Cholesky factors, and pulls and couplings through them."""

    factors: Float[np.ndarray, "N Q Q"]
    pulls: Float[np.ndarray, "N Q"]
    couplings: Float[np.ndarray, "N Q S"]


def fit_articulation(
    state: LearningState, data: Registrations, priors: Priors, held: Float[np.ndarray, "H K 3"]
) -> LearningState:
    """Lower every hand's error by its joints, template, rotations and translations together.

    Args:
        state: of nearly rigid vertices, without correctives; a few hundred, since their system is dense.
        data: registrations.
        priors: their templates, the strengths of joints, and hinges.
        held: joints that these are held to, metres.
    """
    joints, templates = state.joints.copy(), state.templates.copy()
    rotations, translations = state.rotations.copy(), state.translations.copy()
    rig = _rig(state)
    for hand in range(len(templates)):
        rows = np.flatnonzero(data.hands == hand)
        template = priors.templates[hand]
        fixed = _Held(
            data.vertices[rows], template, _patch_turns(template, state.weights), held[hand],
            priors.joint_strengths[hand], priors.hinges,
        )  # fmt: skip
        begun = _Hand(templates[hand], joints[hand], rotations[rows], translations[rows])
        found = _settled(begun, rig, fixed)
        templates[hand], joints[hand] = found.template, found.joints
        rotations[rows], translations[rows] = found.rotations, found.translations
    return replace(state, templates=templates, joints=joints, rotations=rotations, translations=translations)


def _rig(state: LearningState) -> _Rig:
    below = joints_below(state.parents)
    return _Rig(state.weights, state.weights @ below, below, state.parents)


def _patch_turns(
    template: Float[np.ndarray, "V 3"], weights: Float[np.ndarray, "V K"]
) -> Float[np.ndarray, "B3 V3"]:
    """By how much displacements of the vertices turn the patch of every bone as a whole, radians."""
    bones, rows = weights.argmax(axis=1), []
    for bone in np.unique(bones):
        own = np.flatnonzero(bones == bone)
        arms = template[own] - template[own].mean(axis=0)
        inertia = np.square(arms).sum() * np.eye(3) - arms.T @ arms
        turn = np.zeros((3, len(template), 3))
        # A bone with one vertex, or with all of them on a line, turns unseen.
        turn[:, own] = (np.linalg.pinv(inertia) @ skew(arms)).transpose(1, 0, 2)
        rows.append(turn.reshape(3, -1))
    return np.concatenate(rows)


def _settled(hand: _Hand, rig: _Rig, held: _Held) -> _Hand:
    """Levenberg-Marquardt."""
    damping, cost = _FIRST_DAMPING, _cost(hand, rig, held)
    for _ in range(_STEPS):
        try:
            tried = _moved(hand, rig, held, damping)
            lower = _cost(tried, rig, held)
        except np.linalg.LinAlgError:  # not positive definite in the last bit
            tried, lower = hand, np.inf
        if not lower < cost:
            damping *= _HARDER
            continue
        settled = lower > (1 - _SETTLED) * cost
        hand, cost, damping = tried, lower, _EASIER * damping
        if settled:
            break
    return hand


def _posed(hand: _Hand, rig: _Rig) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """World rotations (N, K, 3, 3), places of joints (N, K, 3), of vertices under each joint (N, V, K, 3)."""
    N, K = hand.rotations.shape[:2]
    motions, placed = np.empty((N, K, 12)), np.empty((N, K, 3))
    own = np.zeros(N, dtype=np.int64)
    kernels.joint_motions(
        hand.rotations, hand.joints[None], own, hand.translations, rig.parents, motions, placed
    )
    world = motions[..., :9].reshape(N, K, 3, 3)
    arms = hand.template[:, None] - hand.joints
    places = np.einsum("nkab,vkb->nvka", world, arms, optimize=True) + placed[:, None]
    return world, placed, places


def _cost(hand: _Hand, rig: _Rig, held: _Held) -> float:
    _, _, places = _posed(hand, rig)
    apart = held.vertices - np.einsum("vk,nvka->nva", rig.weights, places)
    moved = hand.template - held.template
    off = hand.joints - held.joints
    cost = np.square(apart).sum() + _TEMPLATE_STRENGTH * np.square(moved).sum()
    cost += _PATCH_STRENGTH * np.square(held.patches @ moved.ravel()).sum()
    cost += np.einsum("ka,kab,kb->", off, held.joint_strengths, off)
    if held.hinges is not None:
        cost += held.hinges.costs(hand.rotations).sum()
    return float(cost)


def _linear(hand: _Hand, rig: _Rig, held: _Held) -> _Linear:
    world, placed, places = _posed(hand, rig)
    weighed = rig.weights[:, :, None] * places
    N, V, K = weighed.shape[:3]
    arms = np.einsum("km,nvka->nvma", rig.below, weighed, optimize=True)
    arms -= rig.carried[:, :, None] * placed[:, None]
    above = np.concatenate([np.tile(np.eye(3), (N, 1, 1, 1)), world[:, rig.parents[1:]]], axis=1)
    turns = np.empty((N, V, 3, 3 + 3 * K))
    turns[..., :3] = np.eye(3)
    spins = -skew(arms.reshape(-1, 3)).reshape(N, V, K, 3, 3) @ above[:, None]
    turns[..., 3:] = spins.transpose(0, 1, 3, 2, 4).reshape(N, V, 3, 3 * K)
    blended = np.einsum("vk,nkab->nvab", rig.weights, world, optimize=True)
    # With the joints: by what is carried times the parent's rotation less the own.
    levers = above - world
    moves = (rig.carried[:, :, None, None] * levers[:, None]).transpose(0, 1, 3, 2, 4)
    return _Linear(held.vertices - weighed.sum(axis=2), turns, blended, levers, moves.reshape(N, V, 3, 3 * K))


def _moved(hand: _Hand, rig: _Rig, held: _Held, damping: float) -> _Hand:
    """One step of everything: poses are eliminated, template and joints solved for, poses follow."""
    linear = _linear(hand, rig, held)
    poses = _poses(hand, held, linear, damping)
    system, gradient = _shared_equations(hand, rig, held, linear)
    system[np.diag_indices(len(system))] *= 1 + damping
    couplings = poses.couplings.reshape(-1, len(system))
    system -= couplings.T @ couplings
    gradient -= couplings.T @ poses.pulls.ravel()
    step = sl.solve(system, gradient, assume_a="pos", overwrite_a=True, check_finite=False)
    left = poses.pulls - poses.couplings @ step
    turned = np.linalg.solve(poses.factors.swapaxes(1, 2), left[..., None])[..., 0]
    V, shape = len(hand.template), hand.rotations.shape
    rotations = matrix_from_axis_angle(np.ascontiguousarray(turned[:, 3:]).reshape(-1, 3)).reshape(shape)
    return _Hand(
        hand.template + step[: 3 * V].reshape(V, 3),
        hand.joints + step[3 * V :].reshape(-1, 3),
        rotations @ hand.rotations,
        hand.translations + turned[:, :3],
    )


def _poses(hand: _Hand, held: _Held, linear: _Linear, damping: float) -> _Poses:
    """Normal equations of every pose, and what couples them to template and joints, behind their factors."""
    N, V, _, Q = linear.turns.shape
    flat = linear.turns.reshape(N, 3 * V, Q)
    systems = flat.swapaxes(1, 2) @ flat
    pulls = (flat.swapaxes(1, 2) @ linear.residuals.reshape(N, -1, 1))[..., 0]
    if held.hinges is not None:
        blocks, turned_back = held.hinges.equations(hand.rotations)
        add_joint_blocks(systems, blocks)
        pulls[:, 3:] += turned_back.reshape(N, -1)
    diagonal = np.einsum("nqq->nq", systems)
    # Relative to the largest: a joint that moves nothing must not make the system singular.
    diagonal += damping * (diagonal + 1e-3 * diagonal.max(axis=1, keepdims=True))
    with_template = linear.turns.swapaxes(2, 3) @ linear.blended
    with_joints = flat.swapaxes(1, 2) @ linear.moves.reshape(N, 3 * V, -1)
    couplings = np.concatenate(
        [with_template.transpose(0, 2, 1, 3).reshape(N, Q, 3 * V), with_joints], axis=2
    )
    factors = np.linalg.cholesky(systems)
    for number in range(N):
        both = np.column_stack([couplings[number], pulls[number]])
        both = sl.solve_triangular(factors[number], both, lower=True, overwrite_b=True, check_finite=False)
        couplings[number], pulls[number] = both[:, :-1], both[:, -1]
    return _Poses(factors, pulls, couplings)


def _shared_equations(
    hand: _Hand, rig: _Rig, held: _Held, linear: _Linear
) -> tuple[Float[np.ndarray, "S S"], Float[np.ndarray, " S"]]:
    """Normal equations of template and joints over all registrations, poses held."""
    N, V, K = len(hand.rotations), len(hand.template), len(hand.joints)
    size = 3 * V
    system = np.zeros((size + 3 * K, size + 3 * K))
    moves = linear.moves.reshape(N * 3 * V, 3 * K)
    system[size:, size:] = moves.T @ moves + block_diagonal(held.joint_strengths)
    levers = linear.levers.transpose(0, 2, 1, 3).reshape(3 * N, 3 * K)
    mixed = levers.T @ linear.blended.transpose(0, 2, 1, 3).reshape(3 * N, size)
    mixed = np.repeat(np.repeat(rig.carried.T, 3, axis=0), 3, axis=1) * mixed
    system[size:, :size], system[:size, size:] = mixed, mixed.T
    blocks = np.einsum("nvca,nvcb->vab", linear.blended, linear.blended, optimize=True)
    places = np.arange(V)
    by_vertex = system[:size, :size].reshape(V, 3, V, 3)
    by_vertex[places, :, places, :] += blocks + _TEMPLATE_STRENGTH * np.eye(3)
    system[:size, :size] += _PATCH_STRENGTH * held.patches.T @ held.patches
    back = (held.template - hand.template).ravel()
    gradient = np.empty(len(system))
    gradient[:size] = np.einsum("nvca,nvc->va", linear.blended, linear.residuals, optimize=True).ravel()
    gradient[:size] += _TEMPLATE_STRENGTH * back + _PATCH_STRENGTH * held.patches.T @ (held.patches @ back)
    gradient[size:] = moves.T @ linear.residuals.ravel()
    gradient[size:] += np.einsum("kab,kb->ka", held.joint_strengths, held.joints - hand.joints).ravel()
    return system, gradient
