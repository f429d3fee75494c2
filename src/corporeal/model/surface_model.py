"""The one surface model. Hands, bodies, bodies with hands and faces are records of it, never subclasses."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np
import scipy.sparse as sp
import torch
from jaxtyping import Float, Int
from torch import Tensor

from corporeal.model.forward import ModelTensors, PosedSurface, posed_surface
from corporeal.model.kernel_arrays import KernelArrays, kernel_arrays
from corporeal.model.landmarks import LandmarkSet
from corporeal.model.pose import FullPose, Pose
from corporeal.model.statistics import PoseBlock
from corporeal.model.vertex_groups import VertexGroup, vertex_groups

Side = Literal["left", "right"]


@dataclass(frozen=True, eq=False)
class CutPlane:
    """A plane that ends the model, fixed to a joint: the wrist of a hand.

    Attributes:
        joint: index of the joint whose frame it is given in.
        point: (3,) a point of the plane in the joint's frame at the zero pose and zero shape, metres.
        normal: (3,) unit normal in the joint's frame, pointing to the side that the model keeps.
    """

    joint: int
    point: Float[np.ndarray, 3]
    normal: Float[np.ndarray, 3]


@dataclass(frozen=True, eq=False)
class SurfaceModel:
    """An articulated surface: template + shape + expression + pose correctives, skinned to a kinematic tree.

    Equations 1-4 of Romero et al. 2017 (MANO). Metres, radians, y up, x to the subject's left, z forward.
    V vertices, F faces, K joints, S shape, E expression directions.

    Attributes:
        name: what it is called, for instance "hand".
        template: (V, 3) zero pose, zero shape.
        faces: (F, 3) vertex indices, counter-clockwise from outside.
        shape_directions: (V, 3, S), scaled so that coefficients have unit variance.
        joint_regressor: (K, V) sparse; rows sum to one.
        skinning_weights: (V, K); rows sum to one.
        parents: (K,) parent of every joint; -1 for the root, which is joint 0.
        joint_names: K names.
        expression_directions: (V, 3, E); E = 0 where the family has no face.
        pose_directions: (V, 3, 9 (K - 1)): offsets per element of the rotation matrices of the joints after
            the root, row-major, minus the identity (equation 3). The third axis may be 0: no correctives.
        side: "left" or "right" for a single hand, None for a whole body.
        parts: part name -> vertex indices.
        pose_blocks: groups of joints with their pose statistics; every joint but the root is in one block.
        landmarks: set name -> landmarks.
        mirror_vertices: (V,) index of the mirrored vertex, where the model is its own mirror image; or None.
        mirror_joints: (K,) the same for joints; or None.
        cut: the plane at which the model ends, or None.
        notes: provenance as text: source, licence, builder.
    """

    name: str
    template: Float[np.ndarray, "V 3"]
    faces: Int[np.ndarray, "F 3"]
    shape_directions: Float[np.ndarray, "V 3 S"]
    joint_regressor: sp.csr_matrix
    skinning_weights: Float[np.ndarray, "V K"]
    parents: Int[np.ndarray, " K"]
    joint_names: tuple[str, ...]
    expression_directions: Float[np.ndarray, "V 3 E"]
    pose_directions: Float[np.ndarray, "V 3 P"]
    side: Side | None = None
    parts: Mapping[str, Int[np.ndarray, " n"]] = field(default_factory=dict)
    pose_blocks: tuple[PoseBlock, ...] = ()
    landmarks: Mapping[str, LandmarkSet] = field(default_factory=dict)
    mirror_vertices: Int[np.ndarray, " V"] | None = None
    mirror_joints: Int[np.ndarray, " K"] | None = None
    cut: CutPlane | None = None
    notes: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        _check_consistency(self)

    @property
    def vertex_count(self) -> int:
        """V."""
        return self.template.shape[0]

    @property
    def joint_count(self) -> int:
        """K, the root included."""
        return len(self.joint_names)

    @property
    def shape_count(self) -> int:
        """S."""
        return self.shape_directions.shape[2]

    @property
    def expression_count(self) -> int:
        """E."""
        return self.expression_directions.shape[2]

    @property
    def has_correctives(self) -> bool:
        """Whether the model stores pose correctives."""
        return self.pose_directions.shape[2] > 0

    def block(self, name: str) -> PoseBlock:
        """The pose block of that name; ``KeyError`` names those that exist."""
        for block in self.pose_blocks:
            if block.name == name:
                return block
        raise KeyError(f"pose block {name!r} is not among {', '.join(b.name for b in self.pose_blocks)}")

    def replace(self, **changes: object) -> SurfaceModel:
        """A copy with some fields changed, checked again."""
        return dataclasses.replace(self, **changes)  # type: ignore[arg-type]

    @cached_property
    def _tensor_cache(self) -> dict[tuple[torch.dtype, torch.device], ModelTensors]:
        return {}

    @cached_property
    def kernel_arrays(self) -> KernelArrays:
        """The model's arrays for the float64 kernels of evaluation and Jacobian, made once and kept."""
        return kernel_arrays(
            template=self.template,
            directions=np.concatenate([self.shape_directions, self.expression_directions], axis=2),
            pose_directions=self.pose_directions,
            joint_regressor=self.joint_regressor,
            skinning_weights=self.skinning_weights,
            parents=self.parents,
        )

    @cached_property
    def vertex_groups(self) -> tuple[VertexGroup, ...]:
        """Which vertices depend on which joints, in a few groups, made once and kept."""
        return vertex_groups(self.kernel_arrays, self.faces)

    def tensors(self, dtype: torch.dtype = torch.float32, device: torch.device | str = "cpu") -> ModelTensors:
        """The model's arrays as tensors of one dtype on one device, made once and kept."""
        key = (dtype, torch.device(device))
        if key not in self._tensor_cache:
            self._tensor_cache[key] = ModelTensors.of_arrays(
                template=self.template,
                shape_directions=np.concatenate([self.shape_directions, self.expression_directions], axis=2),
                pose_directions=self.pose_directions,
                joint_regressor=self.joint_regressor,
                skinning_weights=self.skinning_weights,
                parents=self.parents,
                dtype=dtype,
                device=torch.device(device),
            )
        return self._tensor_cache[key]

    def full_pose(self, pose: Pose) -> FullPose:
        """Resolve coefficients into rotations of all joints.

        Raises:
            KeyError: a block that the model does not have.
            ValueError: more coefficients than components, or a wrong number of joints.
        """
        if isinstance(pose, FullPose):
            if pose.joint_count != self.joint_count:
                raise ValueError(f"pose: {pose.joint_count} joints for a model with {self.joint_count}")
            return pose
        root = pose.root
        blank = torch.zeros_like(root)
        columns: list[Tensor] = [root] + [blank] * (self.joint_count - 1)
        for name, rotation in pose.rotations.items():
            joints = self.block(name).joints
            if rotation.shape[1:] != (len(joints), 3):
                raise ValueError(
                    f"pose: block {name!r} takes (batch, {len(joints)}, 3), got {tuple(rotation.shape)}"
                )
            for column, joint in enumerate(joints):
                columns[joint] = rotation[:, column]
        for name, coefficients in pose.coefficients.items():
            numbers = _expand_coefficients(self.block(name), coefficients)
            for column, joint in enumerate(self.block(name).joints):
                columns[joint] = numbers[:, 3 * column : 3 * column + 3]
        return FullPose(torch.stack(columns, dim=1))

    def __call__(
        self,
        shape: Float[Tensor, "Bs s"] | None,
        pose: Pose,
        expression: Float[Tensor, "Be e"] | None = None,
        translation: Float[Tensor, "Bt 3"] | None = None,
        *,
        correctives: bool = True,
    ) -> PosedSurface:
        """Pose a batch of surfaces (equations 1-4 of the MANO paper).

        Args:
            shape: (B, s) coefficients of the first s <= S shape directions, or None for the template. A batch
                of 1 goes with any number of poses.
            pose: the rotations; its dtype and device decide those of the result.
            expression: (B, e) coefficients of the first e <= E expression directions, or None.
            translation: (B, 3) added after posing, in metres, or None.
            correctives: False leaves the pose correctives out.

        Returns:
            Vertices (B, V, 3), joints (B, K, 3) and T_world_joint (B, K, 4, 4), in metres.

        Raises:
            ValueError: batch sizes that do not match, more coefficients than directions, wrong joint count.
        """
        full = self.full_pose(pose)
        tensors = self.tensors(full.values.dtype, full.values.device)
        return self.posed_by(tensors, shape, full, expression, translation, correctives=correctives)

    def posed_by(
        self,
        tensors: ModelTensors,
        shape: Float[Tensor, "b s"] | None,
        full: FullPose,
        expression: Float[Tensor, "c e"] | None = None,
        translation: Float[Tensor, "d 3"] | None = None,
        *,
        correctives: bool = True,
    ) -> PosedSurface:
        """The same by tensors of this model in the pose's dtype on its device; see ``SurfaceModule``."""
        batch, dtype, device = full.batch, full.values.dtype, full.values.device
        coefficients = self._shape_and_expression(shape, expression, batch, dtype, device)
        if translation is None:
            translation = torch.zeros(batch, 3, dtype=dtype, device=device)
        elif translation.shape[0] not in (1, batch):
            raise ValueError(f"translation: batch of {translation.shape[0]} for {batch} poses")
        if translation.shape[0] != batch:
            translation = translation.expand(batch, 3)
        use_correctives = correctives and self.has_correctives
        return posed_surface(tensors, coefficients, full, translation, use_correctives)

    def _shape_and_expression(
        self, shape: Tensor | None, expression: Tensor | None, batch: int, dtype: torch.dtype,
        device: torch.device,
    ) -> Float[Tensor, "B c"]:  # fmt: skip
        columns = []
        for label, given, count in (
            ("shape", shape, self.shape_count),
            ("expression", expression, self.expression_count),
        ):
            if given is None:
                if count:
                    columns.append(torch.zeros(batch, count, dtype=dtype, device=device))
                continue
            if given.shape[1] > count:
                raise ValueError(f"{label}: {given.shape[1]} coefficients for {count} {label} directions")
            if given.shape[0] not in (1, batch):
                raise ValueError(f"{label}: batch of {given.shape[0]} for {batch} poses")
            if given.dtype != dtype or given.device != device:
                raise ValueError(
                    f"{label}: {given.dtype} on {given.device}, but the pose is {dtype} on {device}"
                )
            columns.append(given if given.shape[0] == batch else given.expand(batch, -1))
            if given.shape[1] < count:
                columns.append(torch.zeros(batch, count - given.shape[1], dtype=dtype, device=device))
        if not columns:
            return torch.zeros(batch, 0, dtype=dtype, device=device)
        return columns[0] if len(columns) == 1 else torch.cat(columns, dim=1)


def _expand_coefficients(block: PoseBlock, coefficients: Tensor) -> Float[Tensor, "B D"]:
    count = coefficients.shape[1]
    if count > len(block.components):
        raise ValueError(
            f"pose: {count} coefficients for the {len(block.components)} components of block {block.name!r}"
        )
    components = torch.as_tensor(block.components[:count]).to(coefficients)
    return coefficients @ components + torch.as_tensor(block.origin).to(coefficients)


def _check_consistency(model: SurfaceModel) -> None:
    V, K = model.vertex_count, model.joint_count
    expected = {
        "shape_directions": (model.shape_directions.shape[:2], (V, 3)),
        "expression_directions": (model.expression_directions.shape[:2], (V, 3)),
        "pose_directions": (model.pose_directions.shape[:2], (V, 3)),
        "joint_regressor": (model.joint_regressor.shape, (K, V)),
        "skinning_weights": (model.skinning_weights.shape, (V, K)),
        "parents": (model.parents.shape, (K,)),
    }
    for field_name, (got, wanted) in expected.items():
        if tuple(got) != wanted:
            raise ValueError(f"{field_name}: shape {tuple(got)}, expected {wanted}")
    if model.pose_directions.shape[2] not in (0, 9 * (K - 1)):
        raise ValueError(
            f"pose_directions: {model.pose_directions.shape[2]} columns, expected 0 or {9 * (K - 1)}"
        )
    if model.faces.size and (model.faces.min() < 0 or model.faces.max() >= V):
        raise ValueError(f"faces: indices outside 0..{V - 1}")
    if model.parents[0] != -1 or (
        K > 1 and not np.all((model.parents[1:] >= 0) & (model.parents[1:] < np.arange(1, K)))
    ):
        raise ValueError(
            "parents: the root must come first with parent -1, and parents before their children"
        )
    for field_name in ("template", "shape_directions", "pose_directions", "skinning_weights"):
        if not np.isfinite(getattr(model, field_name)).all():
            raise ValueError(f"{field_name}: holds NaN or infinite numbers")
