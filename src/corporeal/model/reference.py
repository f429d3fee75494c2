"""Posing a surface in plain torch: the oracle of the kernels (equations 1-4 of Romero et al. 2017)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
import torch
from jaxtyping import Float, Int
from torch import Tensor

from corporeal.model.large_pages import large_page_array


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


class CpuArrays(NamedTuple):
    """What the CPU kernels read, as numpy arrays that share the tensors' memory where they can.

    Attributes:
        parents: (K,).
        joint_template: (K, 3).
        joint_directions: (3 K, C).
        weight_starts: (V + 1,); the non-zero skinning weights of vertex i begin at ``weight_starts[i]``.
        weight_joints: (n,) their joints.
        weight_values: (n,) the weights.
        vertex_starts: (K + 1,); the same weights by joint: those of joint k begin at ``vertex_starts[k]``.
        weight_vertices: (n,) their vertices.
        vertex_values: (n,) the weights.
        basis: (3 V, N), see ``ModelTensors``.
    """

    parents: Int[np.ndarray, " K"]
    joint_template: Float[np.ndarray, "K 3"]
    joint_directions: Float[np.ndarray, "K3 C"]
    weight_starts: Int[np.ndarray, " V1"]
    weight_joints: Int[np.ndarray, " n"]
    weight_values: Float[np.ndarray, " n"]
    vertex_starts: Int[np.ndarray, " K1"]
    weight_vertices: Int[np.ndarray, " n"]
    vertex_values: Float[np.ndarray, " n"]
    basis: Float[np.ndarray, "V3 N"]


@dataclass(frozen=True, eq=False)
class ModelTensors:
    """A model's arrays on one device in one dtype; C = shape and expression directions together.

    Attributes:
        basis: (3 V, N), one row per coordinate: template, shape and expression directions, pose directions.
            In one matrix, because the rest surface is then one matrix product. N >= 1 + C + P: zeros fill the
            row, so that the next begins a cache line; the product for one hand is a fifth faster.
        joint_template: (K, 3), the regressor applied to the template.
        joint_directions: (3 K, C), the regressor applied to the directions: joints are linear in the
            coefficients, so that the regressor itself is not needed per call.
        skinning_weights: (V, K).
        parents: (K,).
    """

    basis: Float[Tensor, "V3 N"]
    joint_template: Float[Tensor, "K 3"]
    joint_directions: Float[Tensor, "K3 C"]
    skinning_weights: Float[Tensor, "V K"]
    parents: Int[np.ndarray, " K"]

    @property
    def template(self) -> Float[Tensor, "V 3"]:
        """Zero pose, zero shape."""
        return self.basis[:, 0].reshape(-1, 3)

    @property
    def directions(self) -> Float[Tensor, "V3 C"]:
        """Shape, then expression directions."""
        return self.basis[:, 1 : 1 + self.joint_directions.shape[1]]

    @property
    def pose_directions(self) -> Float[Tensor, "V3 P"]:
        """Offsets per pose feature; meaningless for a model without correctives."""
        first = 1 + self.joint_directions.shape[1]
        return self.basis[:, first : first + 9 * (len(self.parents) - 1)]

    @cached_property
    def cpu_arrays(self) -> CpuArrays:
        """The same for the CPU kernels; zeros of the weights are left out, but every vertex has an entry."""
        weights = self.skinning_weights.numpy()
        kept = weights != 0
        kept[:, 0] |= ~kept.any(axis=1)
        vertices, joints = np.nonzero(kept)
        by_joint = np.argsort(joints, kind="stable")
        return CpuArrays(
            parents=self.parents,
            joint_template=self.joint_template.numpy(),
            joint_directions=self.joint_directions.numpy(),
            weight_starts=np.searchsorted(vertices, np.arange(len(weights) + 1)),
            weight_joints=joints,
            weight_values=weights[kept],
            vertex_starts=np.searchsorted(joints[by_joint], np.arange(weights.shape[1] + 1)),
            weight_vertices=vertices[by_joint],
            vertex_values=weights[kept][by_joint],
            basis=self.basis.numpy(),
        )

    @cached_property
    def trainable(self) -> bool:
        """Whether any array wants a gradient; only the plain torch path gives one."""
        arrays = (self.basis, self.joint_template, self.joint_directions, self.skinning_weights)
        return any(array.requires_grad for array in arrays)

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
        blocks = [b.reshape(3 * V, -1) for b in (template[:, :, None], shape_directions, pose_directions)]
        precision = np.float64 if dtype == torch.float64 else np.float32
        used = sum(b.shape[1] for b in blocks)
        line = 64 // np.dtype(precision).itemsize
        basis = large_page_array((3 * V, -(-used // line) * line), precision)
        np.concatenate(blocks, axis=1, out=basis[:, :used], casting="same_kind")
        basis[:, used:] = 0

        def tensor(array: np.ndarray) -> Tensor:
            return torch.as_tensor(np.ascontiguousarray(array), dtype=dtype, device=device)

        return cls(
            basis=torch.from_numpy(basis).to(device, dtype),
            joint_template=tensor(joint_regressor @ template),
            joint_directions=tensor(joint_directions.reshape(3 * len(parents), C)),
            skinning_weights=tensor(skinning_weights),
            parents=np.asarray(parents, dtype=np.int64),
        )


def reference_surface(
    tensors: ModelTensors, coefficients: Float[Tensor, "B C"], matrices: Float[Tensor, "B K 3 3"],
    translation: Float[Tensor, "B 3"], correctives: bool,
) -> PosedSurface:  # fmt: skip
    """The plain torch formulation: every device, every order of derivative, ``torch.func``.

    Coefficients are shape, then expression.
    """
    batch, joint_count = matrices.shape[:2]
    rest = tensors.template + (coefficients @ tensors.directions.T).reshape(batch, -1, 3)
    rest_joints = tensors.joint_template + (coefficients @ tensors.joint_directions.T).reshape(batch, -1, 3)
    if correctives:
        identity = torch.eye(3, dtype=matrices.dtype, device=matrices.device)
        feature = (matrices[:, 1:] - identity).reshape(batch, 9 * (joint_count - 1))
        rest = rest + (feature @ tensors.pose_directions.T).reshape(batch, -1, 3)
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
