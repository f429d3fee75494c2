"""Posing a surface: chooses between the kernels and plain torch."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from corporeal.model.fast_path import fast_surface
from corporeal.model.pose import FullPose
from corporeal.model.reference import ModelTensors, PosedSurface, forward_kinematics, reference_surface

__all__ = ["ModelTensors", "PosedSurface", "forward_kinematics", "posed_surface", "reference_surface"]


def posed_surface(
    tensors: ModelTensors, coefficients: Float[Tensor, "B C"], pose: FullPose,
    translation: Float[Tensor, "B 3"], correctives: bool,
) -> PosedSurface:  # fmt: skip
    """Pose a batch; coefficients are shape, then expression.

    On the CPU the numba kernels do the work, with an analytic backward pass. Plain torch takes over on other
    devices and in other dtypes, under ``torch.func`` transforms and ``torch.compile``, and where the model's
    own arrays want gradients. Second derivatives (``create_graph=True``) work too, through plain torch.
    Forward-mode differentiation (``torch.autograd.forward_ad``) is had from ``reference_surface``.
    """
    if _kernels_apply(tensors, pose.values):
        return fast_surface(tensors, coefficients, pose, translation, correctives)
    return reference_surface(tensors, coefficients, pose.matrices(), translation, correctives)


def _kernels_apply(tensors: ModelTensors, values: Tensor) -> bool:
    return (
        values.is_cpu
        and values.dtype in (torch.float32, torch.float64)
        and not tensors.trainable
        and not torch._C._are_functorch_transforms_active()
        and not torch.compiler.is_compiling()
    )
