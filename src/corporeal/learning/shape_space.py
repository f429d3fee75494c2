"""Principal components of personal templates and of poses, and the mixture of poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from corporeal.geometry.rotations_numeric import axis_angle_from_matrix
from corporeal.model.statistics import PoseBlock, PoseMixture

# Least standard deviation of a pose number in the mixture: two degrees.
_FLOOR = np.deg2rad(2.0)
# Components with less than this share of the variance are noise of rounding.
_LEAST_SHARE = 1e-9


@dataclass(frozen=True, eq=False)
class PrincipalComponents:
    """Mean (D,), unit directions (n, D), largest first, and the variances (n,) along them."""

    mean: Float[np.ndarray, " D"]
    directions: Float[np.ndarray, "n D"]
    variances: Float[np.ndarray, " n"]


def principal_components(rows: Float[np.ndarray, "N D"]) -> PrincipalComponents:
    """Of at least two rows; the largest number of every direction is positive, so that signs do not flip."""
    mean = rows.mean(axis=0)
    _, values, directions = np.linalg.svd(rows - mean, full_matrices=False)
    variances = values**2 / (len(rows) - 1)
    kept = variances > _LEAST_SHARE * max(variances.sum(), 1e-300)
    directions, variances = directions[kept], variances[kept]
    return PrincipalComponents(mean, directions * _signs(directions)[:, None], variances)


def shape_directions(
    components: PrincipalComponents,
    count: int,
    prior: Float[np.ndarray, "V 3 S"] | None = None,
    prior_weight: float = 0.0,
) -> Float[np.ndarray, "V 3 n"]:
    """The first directions scaled to unit variance of their coefficients: the prior is then the plain norm.

    Args:
        components: of personal templates.
        count: most directions.
        prior: directions of unit variance of another shape space of the template, for instance the start
            model's.
        prior_weight: of its covariance, added to the learned one across the first learned component; 0 is
            the learned one alone. That component, the size, is what few people tell well: added along it
            too, random hands would differ in size by half as much again as people's do.

    Raises:
        ValueError: a negative weight.
    """
    if not prior_weight >= 0:
        raise ValueError(f"prior_weight: expected 0 or more, got {prior_weight}")
    if prior is not None and prior_weight > 0:
        components = _summed(components, prior, prior_weight)
    scaled = components.directions[:count] * np.sqrt(components.variances[:count, None])
    return np.ascontiguousarray(scaled.T.reshape(-1, 3, len(scaled)))


def _summed(
    components: PrincipalComponents, prior: Float[np.ndarray, "V 3 S"], weight: float
) -> PrincipalComponents:
    """Of the learned covariance plus ``weight`` times the prior's across the first learned component."""
    own = np.sqrt(components.variances)[:, None] * components.directions
    across = prior.reshape(-1, prior.shape[2]).T
    largest = components.directions[0]
    other = np.sqrt(weight) * (across - np.outer(across @ largest, largest))
    _, values, directions = np.linalg.svd(np.concatenate([own, other]), full_matrices=False)
    kept = values**2 > _LEAST_SHARE * np.square(values).sum()
    directions, values = directions[kept], values[kept]
    return PrincipalComponents(components.mean, directions * _signs(directions)[:, None], values**2)


def _signs(directions: Float[np.ndarray, "n D"]) -> Float[np.ndarray, " n"]:
    """The sign of every direction's largest number."""
    return np.sign(directions[np.arange(len(directions)), np.abs(directions).argmax(axis=1)])


def pose_numbers(
    rotations: Float[np.ndarray, "N K 3 3"], joints: tuple[int, ...]
) -> Float[np.ndarray, "N D"]:
    """Axis-angle numbers of some joints, angles in [0, pi]."""
    chosen = np.ascontiguousarray(rotations[:, list(joints)])
    return axis_angle_from_matrix(chosen.reshape(-1, 3, 3)).reshape(len(rotations), -1)


def learned_block(
    block: PoseBlock, rotations: Float[np.ndarray, "N K 3 3"], mixture_components: int, seed: int
) -> tuple[PoseBlock, PrincipalComponents]:
    """The block with mean, components and mixture of the learned poses; its limits are kept."""
    numbers = pose_numbers(rotations, block.joints)
    components = principal_components(numbers)
    learned = PoseBlock(
        name=block.name,
        joints=block.joints,
        mean=components.mean,
        components=components.directions,
        component_deviations=np.sqrt(components.variances),
        mean_included=True,
        mixture=_mixture(numbers, mixture_components, seed),
        limits=block.limits,
    )
    return learned, components


def _mixture(numbers: Float[np.ndarray, "N D"], count: int, seed: int) -> PoseMixture | None:
    """A mixture needs some poses per component; with fewer there are fewer components, and none below ten."""
    from sklearn.mixture import GaussianMixture

    count = min(count, len(numbers) // 10)
    if count < 1:
        return None
    fitted = GaussianMixture(count, reg_covar=_FLOOR**2, random_state=seed, n_init=2).fit(numbers)
    return PoseMixture(fitted.weights_, fitted.means_, fitted.covariances_)
