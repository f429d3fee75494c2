"""A surface model as a torch module: only for ``.to()`` and ``state_dict``; the arithmetic is the model's."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from corporeal.model.forward import ModelTensors, PosedSurface
from corporeal.model.pose import Pose
from corporeal.model.surface_model import SurfaceModel


class SurfaceModule(nn.Module):
    """Holds a model's tensors as buffers and poses them through the model's own functions.

    ``.to(device)`` and ``.to(dtype)`` move the buffers, ``state_dict`` holds them, and they are not trained:
    gradients flow to shape, expression, pose and translation.

    Attributes:
        model: the model that the buffers were made from.
        basis: (3 V, 1 + S + E + P): template, shape, expression and pose directions side by side.
        joint_template: (K, 3) rest joints of the template.
        joint_directions: (3 K, S + E) their change by shape and expression.
        skinning_weights: (V, K).
    """

    basis: Tensor
    joint_template: Tensor
    joint_directions: Tensor
    skinning_weights: Tensor

    def __init__(self, model: SurfaceModel, dtype: torch.dtype = torch.float32) -> None:
        super().__init__()
        self.model = model
        tensors = model.tensors(dtype)
        for name in ("basis", "joint_template", "joint_directions", "skinning_weights"):
            self.register_buffer(name, getattr(tensors, name).clone())
        self._tensors: ModelTensors | None = None
        self._stamp: tuple[tuple[int, int], ...] = ()

    def forward(
        self,
        shape: Float[Tensor, "b s"] | None,
        pose: Pose,
        expression: Float[Tensor, "c e"] | None = None,
        translation: Float[Tensor, "d 3"] | None = None,
        *,
        correctives: bool = True,
    ) -> PosedSurface:
        """Pose a batch; arguments, results and errors are those of ``SurfaceModel.__call__``.

        Raises:
            ValueError: also where the pose is not on the module's device in its dtype.
        """
        full = self.model.full_pose(pose)
        if full.values.dtype != self.basis.dtype or full.values.device != self.basis.device:
            raise ValueError(
                f"pose: {full.values.dtype} on {full.values.device}, but the module is {self.basis.dtype} on "
                f"{self.basis.device}; move one of them with .to()"
            )
        tensors = self._current_tensors()
        return self.model.posed_by(tensors, shape, full, expression, translation, correctives=correctives)

    def _current_tensors(self) -> ModelTensors:
        """The buffers as the kernels' record, rebuilt when ``.to()`` or ``load_state_dict`` changed them."""
        kept = self._tensors
        stamp = tuple((t.data_ptr(), t._version) for t in self.buffers())
        if kept is None or stamp != self._stamp:
            parents = np.asarray(self.model.parents, dtype=np.int64)
            kept = ModelTensors(
                self.basis, self.joint_template, self.joint_directions, self.skinning_weights, parents
            )
            self._tensors, self._stamp = kept, stamp
        return kept
