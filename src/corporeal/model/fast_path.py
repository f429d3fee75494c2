"""Posing on the CPU: numba kernels with an analytic backward pass, as one node of torch's graph."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from corporeal.geometry.rotations import matrix_from_axis_angle
from corporeal.model import lane_kernels, skinning_kernels
from corporeal.model.pose import FullPose
from corporeal.model.reference import ModelTensors, PosedSurface, reference_surface

# Batches from here on are posed LANES at a time; below, padding to LANES costs more than it gains.
_MANY_FROM = 4
# Waking a second thread takes about 80 us: numbers of the basis, and joints, from which it pays.
_PARALLEL_BASIS = 3_000_000
_PARALLEL_JOINTS = 1_000
_CHUNKS = 16


class BatchState(NamedTuple):
    """What the kernels keep of a batch of Bp surfaces, for the backward pass too."""

    row: Float[np.ndarray, "Bp N"]  # 1, coefficients, pose feature: the rest surface is basis @ row
    local: Float[np.ndarray, "Bp K 3 3"]
    rest_joints: Float[np.ndarray, "Bp K 3"]
    motion: Float[np.ndarray, "Bp K 12"]
    joints: Float[np.ndarray, "B K 3"]
    T: Float[np.ndarray, "B K 4 4"]


class Gradients(NamedTuple):
    """Gradients that flow in from what skinning used and from the frames; empty where there is none."""

    motion: Float[np.ndarray, "Bp K 12"]
    row: Float[np.ndarray, "Bp N"]
    joints: Float[np.ndarray, "b K 3"]
    T: Float[np.ndarray, "c K 4 4"]


class ParameterGradients(NamedTuple):
    """Gradients by the parameters."""

    coefficients: Float[np.ndarray, "B C"]
    local: Float[np.ndarray, "B K 3 3"]
    axis_angle: Float[np.ndarray, "b K 3"]
    translation: Float[np.ndarray, "B 3"]


def fast_surface(
    tensors: ModelTensors, coefficients: Float[Tensor, "B C"], pose: FullPose,
    translation: Float[Tensor, "B 3"], correctives: bool,
) -> PosedSurface:  # fmt: skip
    """Pose a batch on the CPU in float32 or float64; coefficients are shape, then expression.

    Gradients are exact, at zero and at pi too. Differentiating twice goes through ``reference_surface``.
    """
    rotation = pose.values if pose.representation == "axis_angle" else pose.matrices()
    return PosedSurface(*_Posing.apply(tensors, coefficients, rotation, translation, correctives))


class _Posing(torch.autograd.Function):
    """(coefficients, axis-angle or matrices, translation) -> (vertices, joints, T_world_joint)."""

    @staticmethod
    def forward(
        ctx: Any, tensors: ModelTensors, coefficients: Tensor, rotation: Tensor, translation: Tensor,
        correctives: bool,
    ) -> tuple[Tensor, Tensor, Tensor]:  # fmt: skip
        ctx.tensors, ctx.correctives = tensors, correctives
        ctx.save_for_backward(coefficients, rotation, translation)
        ctx.set_materialize_grads(False)
        B, K = rotation.shape[:2]
        lanes = lane_kernels.LANES
        padded = B if B < _MANY_FROM else -(-B // lanes) * lanes
        joints, T_world_joint = rotation.new_empty(B, K, 3), rotation.new_empty(B, K, 4, 4)
        parameters = (coefficients.detach(), rotation.detach(), translation.detach())
        state = _posed_joints(tensors, parameters, padded, correctives, (joints, T_world_joint))
        basis = tensors.basis[:, : state.row.shape[1]]
        vertices = rotation.new_empty(B, len(basis) // 3, 3)
        move = parameters[2].numpy()
        if B < _MANY_FROM:
            rest = rotation.new_empty(B, len(basis))
            chunks = _CHUNKS if B * basis.numel() > _PARALLEL_BASIS else 1
            skinning_kernels.pose_few(
                chunks, basis.numpy(), tensors.sparse_weights, state, move, rest.numpy(), vertices.numpy()
            )
        else:
            rest = torch.mm(basis, torch.from_numpy(state.row).T)
            motion = _to_lanes(state.motion)
            lane_kernels.pose_many(tensors.sparse_weights, motion, rest.numpy(), move, vertices.numpy())
        ctx.state, ctx.rest = state, rest
        return vertices, joints, T_world_joint

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor | None) -> tuple[Tensor | None, ...]:
        if torch.is_grad_enabled():  # create_graph=True
            return _reference_gradients(ctx, gradients)
        coefficients, rotation, translation = ctx.saved_tensors
        B, K = rotation.shape[:2]
        by_vertices, by_joints, by_T = gradients
        by_motion, by_row, by_translation = _skinning_gradients(ctx, by_vertices)
        is_vector = rotation.ndim == 3
        out = ParameterGradients(
            np.empty(coefficients.shape, by_row.dtype),
            np.empty((B, K, 3, 3), by_row.dtype),
            np.empty((B if is_vector else 0, K, 3), by_row.dtype),
            by_translation,
        )
        skinning_kernels.unchain(
            B * K > _PARALLEL_JOINTS, _axis_angle(rotation), ctx.tensors.skeleton, ctx.state,
            Gradients(by_motion, by_row, _array(by_joints, (0, K, 3), rotation),
                      _array(by_T, (0, K, 4, 4), rotation)),
            out,
        )  # fmt: skip
        by_rotation = out.axis_angle if is_vector else out.local
        return (
            None, torch.from_numpy(out.coefficients), torch.from_numpy(by_rotation),
            torch.from_numpy(out.translation), None,
        )  # fmt: skip


def _posed_joints(
    tensors: ModelTensors, parameters: tuple[Tensor, Tensor, Tensor], padded: int, correctives: bool,
    frames: tuple[Tensor, Tensor],
) -> BatchState:  # fmt: skip
    """Run the tree and fill ``frames``; surfaces beyond the batch are padding and stay zero."""
    coefficients, rotation, translation = parameters
    B, K = rotation.shape[:2]
    N = tensors.basis.shape[1] if correctives else 1 + coefficients.shape[1]
    dtype = tensors.skeleton.joint_template.dtype
    new = np.empty if padded == B else np.zeros
    if rotation.ndim == 4:
        local = np.zeros((padded, K, 3, 3), dtype)
        local[:B] = rotation.numpy()
    else:
        local = new((padded, K, 3, 3), dtype)
    state = BatchState(
        new((padded, N), dtype), local, new((padded, K, 3), dtype), new((padded, K, 12), dtype),
        frames[0].numpy(), frames[1].numpy(),
    )  # fmt: skip
    skinning_kernels.chain(
        B * K > _PARALLEL_JOINTS, _axis_angle(rotation), coefficients.numpy(), translation.numpy(),
        tensors.skeleton, state,
    )  # fmt: skip
    return state


def _skinning_gradients(ctx: Any, by_vertices: Tensor | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gradients by motions, basis row and translation from that by the vertices."""
    state, rest = ctx.state, ctx.rest
    B = len(state.T)
    by_motion, by_translation = np.zeros_like(state.motion), np.zeros((B, 3), state.row.dtype)
    if by_vertices is None:
        return by_motion, np.zeros_like(state.row), by_translation
    basis, weights = ctx.tensors.basis[:, : state.row.shape[1]], ctx.tensors.sparse_weights
    by_rest, pull = torch.empty_like(rest), by_vertices.contiguous()
    if B < _MANY_FROM:
        skinning_kernels.unpose_few(
            weights, state, rest.numpy(), pull.numpy(), by_motion, by_rest.numpy(), by_translation
        )
        return by_motion, torch.mm(by_rest, basis).numpy(), by_translation
    motion = _to_lanes(state.motion)
    splits = max(1, 4 // len(motion))
    parts = np.zeros((splits, *motion.shape), motion.dtype)
    lane_kernels.unpose_many(splits, weights, motion, rest.numpy(), pull.numpy(), parts, by_rest.numpy())
    by_translation = pull.sum(dim=1).numpy()
    return _from_lanes(parts.sum(axis=0)), torch.mm(by_rest.T, basis).numpy(), by_translation


def _reference_gradients(ctx: Any, gradients: tuple[Tensor | None, ...]) -> tuple[Tensor | None, ...]:
    """The same gradients as a graph that can be differentiated again."""
    coefficients, rotation, translation = ctx.saved_tensors
    with torch.enable_grad():
        matrices = matrix_from_axis_angle(rotation) if rotation.ndim == 3 else rotation
        surface = reference_surface(ctx.tensors, coefficients, matrices, translation, ctx.correctives)
    outputs = (surface.vertices, surface.joints, surface.T_world_joint)
    used = [(value, by) for value, by in zip(outputs, gradients, strict=True) if by is not None]
    inputs = [tensor for tensor in ctx.saved_tensors if tensor.requires_grad]
    found = torch.autograd.grad(
        [value for value, _ in used], inputs, [by for _, by in used], create_graph=True, allow_unused=True
    )
    by_input = iter(found)
    coefficient, turn, move = (next(by_input) if t.requires_grad else None for t in ctx.saved_tensors)
    return None, coefficient, turn, move, None


def _axis_angle(rotation: Tensor) -> np.ndarray:
    if rotation.ndim == 3:
        return rotation.detach().numpy()
    return np.empty((0, rotation.shape[1], 3), rotation.detach().numpy().dtype)


def _array(gradient: Tensor | None, empty: tuple[int, ...], like: Tensor) -> np.ndarray:
    return (like.new_empty(empty) if gradient is None else gradient.contiguous()).detach().numpy()


def _to_lanes(motion: np.ndarray) -> np.ndarray:
    """(B, K, 12) to (B / LANES, K, 12 * LANES): the same number of LANES surfaces side by side."""
    B, K, _ = motion.shape
    lanes = lane_kernels.LANES
    blocks = torch.from_numpy(motion).view(B // lanes, lanes, K, 12).permute(0, 2, 3, 1)
    return blocks.reshape(B // lanes, K, 12 * lanes).numpy()


def _from_lanes(motion: np.ndarray) -> np.ndarray:
    blocks, K, _ = motion.shape
    lanes = lane_kernels.LANES
    return np.ascontiguousarray(motion.reshape(blocks, K, 12, lanes).transpose(0, 3, 1, 2)).reshape(-1, K, 12)
