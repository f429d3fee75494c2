"""Moving a posed surface as one rigid body."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from corporeal.geometry import rotations
from corporeal.model.pose import CoefficientPose, FullPose, Pose
from corporeal.model.surface_model import SurfaceModel

_FROM_MATRIX = {
    "axis_angle": rotations.axis_angle_from_matrix,
    "quaternion": rotations.quaternion_from_matrix,
    "6d": rotations.sixd_from_matrix,
}


def rest_root(
    model: SurfaceModel, shape: Float[Tensor, "b s"] | None, expression: Float[Tensor, "c e"] | None,
    dtype: torch.dtype, device: torch.device,
) -> Float[Tensor, "B 3"]:  # fmt: skip
    """Rest position in metres of the root joint, about which it turns; a batch of 1 without coefficients."""
    tensors = model.tensors(dtype, device)
    position = tensors.joint_template[:1]
    first = 0
    for coefficients, count in ((shape, model.shape_count), (expression, model.expression_count)):
        if coefficients is not None:
            columns = tensors.joint_directions[:3, first : first + coefficients.shape[1]]
            position = position + coefficients @ columns.T
        first += count
    return position


def apply_rigid(
    model: SurfaceModel, R: Float[Tensor, "*r 3 3"], t: Float[Tensor, "*t 3"],
    shape: Float[Tensor, "b s"] | None, pose: Pose, translation: Float[Tensor, "T 3"] | None,
    expression: Float[Tensor, "c e"] | None = None,
) -> tuple[Pose, Float[Tensor, "B 3"]]:  # fmt: skip
    """Parameters of the surface that is moved by x -> R x + t.

    The root turns about its own rest joint j, which lies far from the origin and depends on the shape.
    Turning only the root's rotation and the translation would misplace the surface by (R - I) j, 0.7 m for
    a body.
    With R0 the root's rotation and tau the translation: R0' = R R0, tau' = R (j + tau) + t - j.

    Args:
        model: whose parameters these are.
        R: (3, 3) or (B, 3, 3) rotation matrices.
        t: (3,) or (B, 3) in metres.
        shape: coefficients of the surface, or None for the template's.
        pose: its pose; its dtype and device are used.
        translation: its translation in metres, or None for zero.
        expression: coefficients, or None.

    Returns:
        The pose, in the type and representation in which it came, and the translation. Batched over the
        largest batch given; differentiable. Axis-angle and quaternion roots come back with angles in [0, pi].

    Raises:
        ValueError: batches that do not match.
    """
    like = pose.values if isinstance(pose, FullPose) else pose.root
    R, t = R.reshape(-1, 3, 3), t.reshape(-1, 3)
    tau = torch.zeros(1, 3, dtype=like.dtype, device=like.device) if translation is None else translation
    joint = rest_root(model, shape, expression, like.dtype, like.device)
    batch = max(len(part) for part in (R, t, like, tau, joint))
    for label, part in (("R", R), ("t", t), ("pose", like), ("translation", tau), ("shape", joint)):
        if len(part) not in (1, batch):
            raise ValueError(
                f"{label}: batch of {len(part)} where others hold {batch}; expected 1 or {batch}"
            )
    moved = (R @ (joint + tau).expand(batch, 3)[..., None]).squeeze(-1) + t - joint
    if isinstance(pose, FullPose):
        return _turned_full(pose, R, batch), moved
    return _turned_coefficients(pose, R, batch), moved


def _turned_full(pose: FullPose, R: Float[Tensor, "r 3 3"], batch: int) -> FullPose:
    turned = R[:, None] @ FullPose(pose.values[:, :1], pose.representation).matrices()
    if pose.representation != "matrix":
        turned = _FROM_MATRIX[pose.representation](turned)
    others = _widened(pose.values[:, 1:], batch)
    return FullPose(torch.cat([_widened(turned, batch), others], dim=1), pose.representation)


def _turned_coefficients(pose: CoefficientPose, R: Float[Tensor, "r 3 3"], batch: int) -> CoefficientPose:
    root = rotations.axis_angle_from_matrix(R @ rotations.matrix_from_axis_angle(pose.root))
    return CoefficientPose(
        _widened(root, batch),
        {name: _widened(numbers, batch) for name, numbers in pose.coefficients.items()},
        {name: _widened(numbers, batch) for name, numbers in pose.rotations.items()},
    )


def _widened(values: Tensor, batch: int) -> Tensor:
    return values.expand(batch, *values.shape[1:])
