"""Posing a surface: the torch reference, on any device (equations 1-4 of Romero et al. 2017)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
import torch
from jaxtyping import Float, Int
from torch import Tensor

from corporeal.model.pose import FullPose


@dataclass(frozen=True, eq=False)
class PosedSurface:
    """A batch of posed surfaces in metres.

    Attributes:
        vertices: (B, V, 3).
        joints: (B, K, 3), the origins of ``T_world_joint``.
        T_world_joint: (B, K, 4, 4); maps coordinates of a joint's frame to the world. At the zero pose its
            rotation is the identity.
    """

    vertices: Float[Tensor, "B V 3"]
    joints: Float[Tensor, "B K 3"]
    T_world_joint: Float[Tensor, "B K 4 4"]


@dataclass(frozen=True, eq=False)
class ModelTensors:
    """A model's arrays on one device in one dtype; C = shape and expression directions together.

    ``joint_template`` and ``joint_directions`` are the regressor applied to template and directions: joints
    are linear in the coefficients, so that the regressor itself is not needed per call.
    """

    template: Float[Tensor, "V 3"]
    directions: Float[Tensor, "V3 C"]
    pose_directions: Float[Tensor, "P V3"]
    joint_template: Float[Tensor, "K 3"]
    joint_directions: Float[Tensor, "K3 C"]
    skinning_weights: Float[Tensor, "V K"]
    parents: Int[np.ndarray, " K"]

    @classmethod
    def of_arrays(
        cls,
        *,
        template: np.ndarray,
        shape_directions: np.ndarray,
        pose_directions: np.ndarray,
        joint_regressor: sp.csr_matrix,
        skinning_weights: np.ndarray,
        parents: np.ndarray,
        dtype: torch.dtype,
        device: torch.device,
    ) -> ModelTensors:
        """Build from numpy arrays; the regressor is folded in float64 before rounding."""
        V, _, C = shape_directions.shape
        joint_directions = joint_regressor @ shape_directions.reshape(V, 3 * C)

        def tensor(array: np.ndarray) -> Tensor:
            return torch.as_tensor(np.ascontiguousarray(array), dtype=dtype, device=device)

        return cls(
            template=tensor(template),
            directions=tensor(shape_directions.reshape(3 * V, C)),
            pose_directions=tensor(pose_directions.reshape(3 * V, -1).T),
            joint_template=tensor(joint_regressor @ template),
            joint_directions=tensor(joint_directions.reshape(3 * len(parents), C)),
            skinning_weights=tensor(skinning_weights),
            parents=np.asarray(parents, dtype=np.int64),
        )


def posed_surface(
    tensors: ModelTensors, coefficients: Float[Tensor, "B C"], pose: FullPose,
    translation: Float[Tensor, "B 3"], correctives: bool,
) -> PosedSurface:  # fmt: skip
    """Pose a batch on any device; coefficients are shape, then expression."""
    return reference_surface(tensors, coefficients, pose.matrices(), translation, correctives)


def reference_surface(
    tensors: ModelTensors, coefficients: Float[Tensor, "B C"], matrices: Float[Tensor, "B K 3 3"],
    translation: Float[Tensor, "B 3"], correctives: bool,
) -> PosedSurface:  # fmt: skip
    """The plain torch formulation: the oracle of the kernels and the path for every device but the CPU."""
    batch, joint_count = matrices.shape[:2]
    rest = tensors.template + (coefficients @ tensors.directions.T).reshape(batch, -1, 3)
    rest_joints = tensors.joint_template + (coefficients @ tensors.joint_directions.T).reshape(batch, -1, 3)
    if correctives:
        identity = torch.eye(3, dtype=matrices.dtype, device=matrices.device)
        feature = (matrices[:, 1:] - identity).reshape(batch, 9 * (joint_count - 1))
        rest = rest + (feature @ tensors.pose_directions).reshape(batch, -1, 3)
    T_world_joint = forward_kinematics(matrices, rest_joints, tensors.parents)
    rotation = T_world_joint[..., :3, :3]
    # What skinning applies to rest coordinates: x -> R x + (joint - R rest_joint).
    offset = T_world_joint[..., :3, 3] - (rotation @ rest_joints[..., None]).squeeze(-1)
    blended = tensors.skinning_weights @ torch.cat([rotation.flatten(2), offset], dim=-1)
    blended_rotation = blended[..., :9].reshape(batch, -1, 3, 3)
    vertices = (blended_rotation @ rest[..., None]).squeeze(-1) + blended[..., 9:]
    moved = T_world_joint.clone()
    moved[..., :3, 3] = moved[..., :3, 3] + translation[:, None]
    return PosedSurface(vertices + translation[:, None], moved[..., :3, 3], moved)


def forward_kinematics(
    matrices: Float[Tensor, "B K 3 3"], rest_joints: Float[Tensor, "B K 3"], parents: Int[np.ndarray, " K"]
) -> Float[Tensor, "B K 4 4"]:
    """Chain the joints' rotations down the tree; the root turns about its own rest position."""
    rotations, positions = [matrices[:, 0]], [rest_joints[:, 0]]
    for joint in range(1, len(parents)):
        parent = int(parents[joint])
        bone = (rest_joints[:, joint] - rest_joints[:, parent])[..., None]
        rotations.append(rotations[parent] @ matrices[:, joint])
        positions.append((rotations[parent] @ bone).squeeze(-1) + positions[parent])
    top = torch.cat([torch.stack(rotations, 1), torch.stack(positions, 1)[..., None]], dim=-1)
    bottom = torch.tensor([0.0, 0, 0, 1], dtype=top.dtype, device=top.device).expand(*top.shape[:2], 1, 4)
    return torch.cat([top, bottom], dim=2)
