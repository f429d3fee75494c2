"""The steps that move personal templates and their joints: both linear, both solved exactly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from corporeal.learning import skinning_kernels as kernels
from corporeal.learning.objective import Priors
from corporeal.learning.options import LearningOptions
from corporeal.learning.state import LearningState, Registrations

_UPPER = np.triu_indices(3)


def fit_templates(
    state: LearningState, data: Registrations, priors: Priors, options: LearningOptions
) -> LearningState:
    """Every hand's template: a 3 x 3 system per vertex, tied together by the regressed joints alone."""
    H, V = state.templates.shape[:2]
    squares, pulls = np.zeros((H, V, 6)), np.zeros((H, V, 3))
    weights = state.weight_table()
    for posed in state.posed(data):
        rows = posed.rows
        kernels.template_moments(
            weights, posed.motions, state.offsets(rows), data.vertices[rows], data.importance[rows],
            data.hands[rows], squares, pulls,
        )  # fmt: skip
    systems = np.empty((H, V, 3, 3))
    systems[..., _UPPER[0], _UPPER[1]] = squares
    systems[..., _UPPER[1], _UPPER[0]] = squares
    systems += options.template_strength * np.eye(3)
    pulls += options.template_strength * priors.templates
    regressor = state.regressor.toarray()
    templates = np.stack(
        [
            _tied_solution(systems[h], pulls[h], regressor, state.joints[h], priors.joint_strengths[h])
            for h in range(H)
        ]
    )
    return replace(state, templates=templates)


def _tied_solution(
    systems: Float[np.ndarray, "V 3 3"], pulls: Float[np.ndarray, "V 3"], regressor: Float[np.ndarray, "K V"],
    joints: Float[np.ndarray, "K 3"], strengths: Float[np.ndarray, "K 3 3"],
) -> Float[np.ndarray, "V 3"]:  # fmt: skip
    """Blocks of 3 x 3 plus |regressor x - joints|^2 in the norm of ``strengths``: Woodbury's identity."""
    K = len(joints)
    inverse = np.linalg.inv(systems)
    pulls = pulls + regressor.T @ np.einsum("kab,kb->ka", strengths, joints)
    free = np.einsum("vab,vb->va", inverse, pulls)
    used = np.flatnonzero(regressor.any(axis=0))
    some = regressor[:, used]
    small = np.einsum("kv,lv,vab->kalb", some, some, inverse[used], optimize=True).reshape(3 * K, 3 * K)
    small += block_diagonal(np.linalg.inv(strengths))
    tension = np.linalg.solve(small, (regressor @ free).reshape(-1)).reshape(K, 3)
    free[used] -= np.einsum("vab,kv,kb->va", inverse[used], some, tension, optimize=True)
    return free


def fit_joints(
    state: LearningState,
    data: Registrations,
    strengths: Float[np.ndarray, "H K 3 3"],
    held: Float[np.ndarray, "H K 3"] | None = None,
) -> LearningState:
    """Every hand's joints together with the translations of its registrations, which are eliminated.

    They are held to ``held``, or to where the regressor puts them, by ``strengths`` observations.

    A vertex moves with joint m by s_m (R_parent - R_m), where s_m is the weight of m and all its descendants.
    """
    K, H = len(state.parents), len(state.templates)
    mean, centred = _carried(state)
    spread = centred.T @ centred
    if held is None:
        held = np.stack([state.regressor @ template for template in state.templates])
    systems = np.stack([block_diagonal(own) for own in strengths])
    pulls = np.einsum("hkab,hkb->hka", strengths, held - state.joints).reshape(H, -1)
    residual_means = np.empty((len(data.hands), 3))
    weights = state.weight_table()
    levers = np.empty((len(data.hands), K, 3, 3))
    for posed in state.posed(data):
        rows, importance = posed.rows, data.importance[posed.rows]
        surface = np.empty_like(posed.rest)
        kernels.posed_vertices(weights, posed.motions, posed.rest, surface)
        residuals = data.vertices[rows] - surface
        residual_means[rows] = residuals.mean(axis=1)
        lever = _levers(state, posed.motions)
        levers[rows] = lever
        gathered = np.einsum("vk,nva->nka", centred, residuals, optimize=True)
        np.add.at(
            pulls,
            data.hands[rows],
            importance[:, None] * np.einsum("nkab,nka->nkb", lever, gathered).reshape(-1, 3 * K),
        )
        products = np.einsum("n,kl,nkca,nlcb->nkalb", importance, spread, lever, lever, optimize=True)
        np.add.at(systems, data.hands[rows], products.reshape(-1, 3 * K, 3 * K))
    steps = np.linalg.solve(systems, pulls[..., None])[..., 0].reshape(H, K, 3)
    moved = np.einsum("k,nkab,nkb->na", mean, levers, steps[data.hands], optimize=True)
    return replace(
        state, joints=state.joints + steps, translations=state.translations + residual_means - moved
    )


def _levers(state: LearningState, motions: Float[np.ndarray, "n K 12"]) -> Float[np.ndarray, "n K 3 3"]:
    """R_parent - R of every joint; I - R of the root."""
    world = motions[..., :9].reshape(*motions.shape[:2], 3, 3)
    parents = np.concatenate(
        [np.tile(np.eye(3), (len(motions), 1, 1, 1)), world[:, state.parents[1:]]], axis=1
    )
    return parents - world


def joint_strengths(
    state: LearningState, data: Registrations, options: LearningOptions
) -> Float[np.ndarray, "H K 3 3"]:
    """How many observations hold a joint in each direction: a share of what others are observed better.

    A joint that turns about one axis is not seen along it: there it is held, and nearly free across. One
    strength for all joints either held knuckles back, or let the outer joints of the fingers slide out of the
    finger (4 mm, along with the twist of registrations); one strength for all directions of a joint kept the
    thumb's root where the start model had it, 6 mm off.
    """
    _, centred = _carried(state)
    spread = np.einsum("vk,vk->k", centred, centred)
    seen = np.zeros((*state.joints.shape, 3))
    for posed in state.posed(data):
        levers = _levers(state, posed.motions)
        np.add.at(seen, data.hands[posed.rows], np.einsum("k,nkca,nkcb->nkab", spread, levers, levers))
    most = np.linalg.eigvalsh(seen)[..., -1]
    unseen = most[..., None, None] * np.eye(3) - seen
    return options.joint_strength * np.eye(3) + options.joint_share * unseen


def block_diagonal(blocks: Float[np.ndarray, "K 3 3"]) -> Float[np.ndarray, "K3 K3"]:
    """The square matrix with these blocks on its diagonal."""
    K = len(blocks)
    placed = np.zeros((K, 3, K, 3))
    placed[np.arange(K), :, np.arange(K), :] = blocks
    return placed.reshape(3 * K, 3 * K)


def _carried(state: LearningState) -> tuple[Float[np.ndarray, " K"], Float[np.ndarray, "V K"]]:
    """Weight of every joint with its descendants: mean over the vertices, and without the mean."""
    carried = state.weights.copy()
    for joint in range(len(state.parents) - 1, 0, -1):
        carried[:, state.parents[joint]] += carried[:, joint]
    mean = carried.mean(axis=0)
    return mean, carried - mean
