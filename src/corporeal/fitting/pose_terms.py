"""Priors on the pose while tracking: body, hands, limits and zero velocity (equations 16-19 and 21)."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from corporeal.fitting.options import TrackingOptions
from corporeal.model.jacobian import ParameterColumns
from corporeal.model.statistics import PoseBlock
from corporeal.model.surface_model import SurfaceModel
from corporeal.solve.problem import Term
from corporeal.solve.subspace import AffineSubspace
from corporeal.terms.gaussian_prior import GaussianPrior
from corporeal.terms.hinges import HINGE_SIGMA, hinge_terms
from corporeal.terms.pose_limits import PoseLimits
from corporeal.terms.pose_mixture import MixturePrior
from corporeal.terms.pose_subspace import block_columns, pose_subspace

# A scan says nothing of the eyes, and little of the jaw: single joints of the head stay near zero.
_LONE_JOINT = 0.03
_LIMIT = 0.1
# Toes, and what carries them, bend up and down, about x. Free to turn sideways, each slipped to the next
# one's place and stayed there, 15 to 28 degrees off.
_TOES = {"left_foot": "left_ankle", "right_foot": "right_ankle"}
_TOES_SIDEWAYS = 0.03
# lambda_theta_b was found for a spread of one radian about the mean; recorded poses spread by a third of it.
_BODY_MIXTURE = 0.1
# A direction in which the recorded poses hardly vary is not forbidden: 3 degrees about it stay cheap.
_FLOOR = np.deg2rad(3.0)


def pose_terms(
    model: SurfaceModel,
    columns: ParameterColumns,
    options: TrackingOptions,
    annealing: float,
    *,
    previous: Float[np.ndarray, "K 3"] | None,
    body_prior: bool,
    pull: Float[np.ndarray, " K"] | None = None,
) -> list[Term]:
    """All terms that speak of the pose alone.

    Args:
        model: what is tracked.
        columns: of its parameters.
        options: weights and ablations.
        annealing: lambda_a.
        previous: pose of the last good frame, or None where there is none.
        body_prior: whether the body's pose is held to the recorded ones.
        pull: (K,) factors on the zero-velocity term, by joint; None for one.
    """
    terms: list[Term] = []
    for block in model.pose_blocks:
        where = block_columns(block, columns)
        if is_hand(block):
            terms += _hand_terms(block, where, options, options.weights.hand_pose / annealing)
        elif len(block.joints) == 1 and block.name != "body":
            terms.append(GaussianPrior.isotropic(f"{block.name} prior", where, block.mean, _LONE_JOINT))
        elif body_prior:
            terms.append(_body_term(block, where, options.weights.body_pose / annealing))
        if block.limits is not None:
            terms.append(PoseLimits(f"{block.name} limits", where, block.limits, _LIMIT))
    terms += hinge_terms(model, columns, HINGE_SIGMA)
    terms += _toe_terms(model, columns)
    if options.velocity and previous is not None:
        stiffness = np.repeat(np.ones(len(previous)) if pull is None else pull, 3) * options.weights.velocity
        terms.append(GaussianPrior("velocity", columns.pose, previous.ravel(), np.diag(stiffness)))
    return terms


def tracking_subspace(
    model: SurfaceModel, columns: ParameterColumns, options: TrackingOptions
) -> AffineSubspace | None:
    """The parameters that are free: hands by components, flat, or None where all are."""
    hands = [block for block in model.pose_blocks if is_hand(block)]
    if options.hands == "full" or not hands:
        return None
    if options.hands == "components":
        return pose_subspace(model, columns, options.components)
    free = np.ones(columns.count, dtype=bool)
    for block in hands:
        free[block_columns(block, columns)] = False
    return AffineSubspace(np.zeros(columns.count), np.eye(columns.count)[:, free])


def is_hand(block: PoseBlock) -> bool:
    """Whether principal components of its poses are known, as they are of hands."""
    return len(block.components) > 0


def _toe_terms(model: SurfaceModel, columns: ParameterColumns) -> list[Term]:
    """Toes of a model that names its joints as SMPL does turn about x alone; nothing for any other."""
    stiffness = np.zeros((model.joint_count, 3))
    for joint, parent in enumerate(model.parents):
        if joint and _TOES.get(model.joint_names[joint]) == model.joint_names[parent]:
            stiffness[joint, 1:] = 1 / _TOES_SIDEWAYS**2
    if not stiffness.any():
        return []
    return [GaussianPrior("toes", columns.pose, np.zeros(stiffness.size), np.diag(stiffness.ravel()))]


def _body_term(block: PoseBlock, where: slice, weight: float) -> Term:
    """The recorded poses where they are known, or a pull to the mean pose."""
    name, found = f"{block.name} prior", block.mixture
    if found is None:
        return GaussianPrior.isotropic(name, where, block.mean, float(np.sqrt(1 / weight)))
    covariances = found.covariances + _FLOOR**2 * np.eye(len(block.mean))
    return MixturePrior(name, where, found.weights, found.means, covariances, weight=_BODY_MIXTURE * weight)


def _hand_terms(block: PoseBlock, where: slice, options: TrackingOptions, weight: float) -> list[Term]:
    if options.hand_prior == "none":
        return []
    name, floor = f"{block.name} prior", _FLOOR**2 * np.eye(len(block.mean))
    if options.hand_prior == "mixture" and block.mixture is not None:
        found = block.mixture
        covariances = found.covariances + floor
        return [MixturePrior(name, where, found.weights, found.means, covariances, weight=weight)]
    spread = block.components * block.component_deviations[:, None]
    precision = np.linalg.inv(spread.T @ spread + floor)
    return [GaussianPrior(name, where, block.mean, weight * precision)]
