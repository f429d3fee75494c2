"""The prior terms of a model's parameters: shape, pose and anatomical limits."""

from __future__ import annotations

import numpy as np

from corporeal.model.jacobian import ParameterColumns
from corporeal.model.statistics import PoseBlock
from corporeal.model.surface_model import SurfaceModel
from corporeal.registration.gaussian_pose import GaussianPose
from corporeal.solve.problem import Term
from corporeal.terms.gaussian_prior import GaussianPrior
from corporeal.terms.hinges import HINGE_SIGMA, hinge_terms
from corporeal.terms.pose_limits import PoseLimits
from corporeal.terms.pose_mixture import MixturePrior
from corporeal.terms.pose_subspace import block_columns

# A direction in which the recorded poses hardly vary is not forbidden: 3 degrees about it stay cheap.
_FLOOR = np.deg2rad(3.0)
# Where nothing is known of a joint, half a radian is one standard deviation.
_UNKNOWN = 0.5
# A scan does not say where eyes look: their skin, a ball, is drawn to lids and lashes and turns at random.
_EYES, _EYES_HELD = ("leye", "reye"), 0.03


def prior_terms(
    model: SurfaceModel,
    columns: ParameterColumns,
    *,
    shape_sigma: float,
    pose_prior_scale: float,
    limit_sigma: float,
    pose_prior: GaussianPose | None = None,
) -> list[Term]:
    """Shape prior; per pose block the prior given, its mixture, Gaussian or a weak pull to zero; limits."""
    shape_size = columns.shape.stop - columns.shape.start
    mean = np.zeros(shape_size)
    terms: list[Term] = [GaussianPrior.isotropic("shape prior", columns.shape, mean, shape_sigma)]
    for block in model.pose_blocks:
        where = block_columns(block, columns)
        if pose_prior is None:
            terms.append(_pose_prior(block, where, pose_prior_scale))
        else:
            terms.append(_given_prior(block, where, pose_prior.for_side(model.side), pose_prior_scale))
        if block.limits is not None:
            terms.append(PoseLimits(f"{block.name} limits", where, block.limits, limit_sigma))
    return terms + hinge_terms(model, columns, HINGE_SIGMA)


def _pose_prior(block: PoseBlock, where: slice, scale: float) -> Term:
    name = f"{block.name} prior"
    if block.name in _EYES:
        return GaussianPrior.isotropic(name, where, block.mean, _EYES_HELD)
    if block.mixture is not None:
        mixture = block.mixture
        widened = mixture.covariances + _FLOOR**2 * np.eye(len(block.mean))
        return MixturePrior(name, where, mixture.weights, mixture.means, widened, sigma_scale=scale)
    if len(block.components):
        spread = block.components * block.component_deviations[:, None]
        covariance = spread.T @ spread + _FLOOR**2 * np.eye(len(block.mean))
        return GaussianPrior(name, where, block.mean, np.linalg.inv(covariance) / scale**2)
    return GaussianPrior.isotropic(name, where, block.mean, scale * _UNKNOWN)


def _given_prior(block: PoseBlock, where: slice, prior: GaussianPose, scale: float) -> Term:
    """The block's share of a Gaussian over all joints after the root."""
    own = (3 * (np.asarray(block.joints)[:, None] - 1) + np.arange(3)).ravel()
    if own.max() >= len(prior.mean):
        raise ValueError(f"pose_prior: {len(prior.mean)} numbers, too few for pose block {block.name!r}")
    covariance = prior.covariance[np.ix_(own, own)] + _FLOOR**2 * np.eye(len(own))
    return GaussianPrior(f"{block.name} prior", where, prior.mean[own], np.linalg.inv(covariance) / scale**2)
