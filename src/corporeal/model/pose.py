"""Poses with explicit types: a full pose and a pose of coefficients are never told apart by length."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

from corporeal.geometry import rotations

Representation = Literal["axis_angle", "matrix", "quaternion", "6d"]

_TO_MATRIX = {
    "axis_angle": rotations.matrix_from_axis_angle,
    "quaternion": rotations.matrix_from_quaternion,
    "6d": rotations.matrix_from_6d,
}
_TRAILING = {"axis_angle": (3,), "matrix": (3, 3), "quaternion": (4,), "6d": (6,)}


@dataclass(frozen=True, eq=False)
class FullPose:
    """The rotation of every joint against its parent, absolute: no mean pose is added to it.

    Attributes:
        values: (B, K, ...) rotations of all K joints, the root first; trailing shape (3,) for axis-angle in
            radians, (3, 3) for matrices, (4,) for quaternions (w, x, y, z), (6,) for two columns.
        representation: which of the four.
    """

    values: Tensor
    representation: Representation = "axis_angle"

    def __post_init__(self) -> None:
        trailing = _TRAILING[self.representation]
        if self.values.ndim != 2 + len(trailing) or tuple(self.values.shape[2:]) != trailing:
            wanted = ", ".join(["batch", "joints", *map(str, trailing)])
            raise ValueError(
                f"pose: expected a tensor of shape ({wanted}) for {self.representation}, "
                f"got {tuple(self.values.shape)}"
            )

    @property
    def batch(self) -> int:
        """Number of poses."""
        return self.values.shape[0]

    @property
    def joint_count(self) -> int:
        """Number of joints, the root included."""
        return self.values.shape[1]

    def matrices(self) -> Float[Tensor, "B K 3 3"]:
        """Rotation matrices, whatever the representation."""
        if self.representation == "matrix":
            return self.values
        return _TO_MATRIX[self.representation](self.values)

    def axis_angles(self) -> Float[Tensor, "B K 3"]:
        """Axis-angle vectors in radians, angles in [0, pi] unless they were given as axis-angle."""
        if self.representation == "axis_angle":
            return self.values
        return rotations.axis_angle_from_matrix(self.matrices())


@dataclass(frozen=True, eq=False)
class CoefficientPose:
    """Some blocks by principal-component coefficients, the others by axis-angle.

    Attributes:
        root: (B, 3) axis-angle of the root in radians.
        coefficients: block name -> (B, c) coefficients of its first c components. Whether zero means the mean
            pose or the zero pose is a property of the block (``PoseBlock.mean_included``).
        rotations: block name -> (B, n, 3) axis-angle of all joints of a block, absolute.
            A block in neither mapping stays at its zero pose.
    """

    root: Float[Tensor, "B 3"]
    coefficients: Mapping[str, Tensor] = field(default_factory=dict)
    rotations: Mapping[str, Tensor] = field(default_factory=dict)

    def __post_init__(self) -> None:
        both = set(self.coefficients) & set(self.rotations)
        if both:
            raise ValueError(
                f"pose: block {sorted(both)[0]!r} is given both by coefficients and by rotations"
            )


Pose = FullPose | CoefficientPose


def zero_pose(
    joint_count: int, batch: int = 1, dtype: torch.dtype = torch.float32, device: torch.device | str = "cpu"
) -> FullPose:
    """The zero pose: every joint unrotated."""
    return FullPose(torch.zeros(batch, joint_count, 3, dtype=dtype, device=device))
