"""A Gaussian over the poses of one protocol pose, learned from accepted registrations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

_FEWEST = 3
# The general covariance counts as this many poses: below it the poses' own covariance, of rank n - 1 in some
# forty dimensions, says little.
_GENERAL_COUNT = 10.0
# Mirroring turns a rotation vector's y and z about: it is an axial vector, and x is the mirrored axis.
_MIRROR = np.array([1.0, -1.0, -1.0])


@dataclass(frozen=True, eq=False)
class GaussianPose:
    """A Gaussian over the axis-angle numbers of the joints after the root, radians.

    Attributes:
        mean: (D,) with D = 3 (K - 1).
        covariance: (D, D), positive semi-definite.
        side: of the hand that it speaks of; None for a model without a side.
    """

    mean: Float[np.ndarray, " D"]
    covariance: Float[np.ndarray, "D D"]
    side: Literal["left", "right"] | None = None

    def for_side(self, side: Literal["left", "right"] | None) -> GaussianPose:
        """The same poses of the other hand where the side is another."""
        if side is None or self.side is None or side == self.side:
            return self
        signs = np.tile(_MIRROR, len(self.mean) // 3)
        return GaussianPose(signs * self.mean, signs[:, None] * self.covariance * signs, side)

    @property
    def pose(self) -> Float[np.ndarray, "K 3"]:
        """The mean of all joints, the root unrotated."""
        return np.concatenate([np.zeros((1, 3)), self.mean.reshape(-1, 3)])


def mirrored_pose(pose: Float[np.ndarray, "K 3"]) -> Float[np.ndarray, "K 3"]:
    """The pose of the mirrored hand."""
    return pose * _MIRROR


def pose_priors(
    poses: Mapping[str, Sequence[Float[np.ndarray, "K 3"]]], side: Literal["left", "right"] | None
) -> dict[str, GaussianPose]:
    """One Gaussian per protocol pose that has at least three accepted registrations.

    The covariance is the posterior mean under an inverse Wishart prior around the general covariance (that of
    all accepted poses about their mean), widened by what is not known of the mean.

    Args:
        poses: protocol pose -> accepted poses, all of one side.
        side: which.
    """
    numbers = {name: np.array([pose[1:].ravel() for pose in found]) for name, found in poses.items() if found}
    if not numbers:
        return {}
    everything = np.concatenate([numbers[name] for name in sorted(numbers)]).astype(np.float64)
    general = _scatter(everything) / max(len(everything) - 1, 1)
    priors = {}
    for name in sorted(numbers):
        own = numbers[name].astype(np.float64)
        count = len(own)
        if count < _FEWEST:
            continue
        covariance = (_scatter(own) + _GENERAL_COUNT * general) / (count - 1 + _GENERAL_COUNT)
        priors[name] = GaussianPose(own.mean(axis=0), covariance * (1 + 1 / count), side)
    return priors


def _scatter(numbers: np.ndarray) -> Float[np.ndarray, "D D"]:
    centred = numbers - numbers.mean(axis=0)
    return centred.T @ centred
