"""What is known about the poses of a part: mean, principal components, mixture, anatomical limits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True, eq=False)
class PoseMixture:
    """Gaussian mixture over the axis-angle numbers of a block (radians): M components in D dimensions."""

    weights: Float[np.ndarray, " M"]
    means: Float[np.ndarray, "M D"]
    covariances: Float[np.ndarray, "M D D"]


@dataclass(frozen=True, eq=False)
class PoseBlock:
    """A named group of joints whose pose can be given in full or by coefficients.

    Attributes:
        name: for instance "hand", "left_hand", "body", "jaw".
        joints: indices of the joints, in the order of the numbers; D = 3 * len(joints).
        mean: (D,) axis-angle mean pose in radians; zeros where nothing is known.
        components: (C, D) principal directions, largest first; none where nothing is known.
        component_deviations: (C,) standard deviation of each coefficient over the data.
        mean_included: True where coefficients are counted from the mean (coefficients of zero give the mean
            pose), False where they are counted from the zero pose. smplx calls its opposite
            ``flat_hand_mean``.
        mixture: Gaussian mixture over the D numbers, or None.
        limits: (D, 2) lower and upper anatomical limit of every number in radians, or None.
    """

    name: str
    joints: tuple[int, ...]
    mean: Float[np.ndarray, " D"]
    components: Float[np.ndarray, "C D"]
    component_deviations: Float[np.ndarray, " C"]
    mean_included: bool = True
    mixture: PoseMixture | None = None
    limits: Float[np.ndarray, "D 2"] | None = None

    @classmethod
    def plain(cls, name: str, joints: tuple[int, ...]) -> PoseBlock:
        """A block of which nothing is known: zero mean, no components."""
        size = 3 * len(joints)
        return cls(name, joints, np.zeros(size), np.zeros((0, size)), np.zeros(0))

    @property
    def origin(self) -> Float[np.ndarray, " D"]:
        """The pose of zero coefficients."""
        return self.mean if self.mean_included else np.zeros_like(self.mean)
