"""Posing on the CPU: numba kernels with an analytic backward pass, as one node of torch's graph."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from corporeal.geometry.rotations import matrix_from_axis_angle
from corporeal.model import lane_kernels, skinning_kernels
from corporeal.model.batch_state import (
    BatchState,
    Incoming,
    OutputGradients,
    ParameterGradients,
    Parameters,
    Skinned,
)
from corporeal.model.pose import FullPose
from corporeal.model.reference import ModelTensors, PosedSurface, reference_surface

# Batches from here on are posed LANES at a time; below, padding to LANES costs more than it gains.
_MANY_FROM = 4
# Waking a second thread takes about 80 us: numbers of the basis, and joints, from which it pays.
_PARALLEL_BASIS = 3_000_000
_PARALLEL_JOINTS = 1_000
_CHUNKS = 16
_SPLITS = 8  # of the vertices on the way back, each with its own sums
# A pass writes the rest surfaces of a part of a large batch by a matrix product and skins them. Its size
# bounds the memory beside the result: passes of 16, 8 and 4 MB were measured to be 1.1, 1.3 and 1.8 times as
# slow as one of 64 MB for 256 bodies, because the product becomes narrow.
_PASS_BYTES = 64_000_000


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
        given = _parameters(coefficients, rotation, translation)
        state = _blank_state(given, rotation, correctives)
        kept: Skinned | list[np.ndarray]
        if len(state.joints) < _MANY_FROM:
            vertices, kept = _pose_few(tensors, given, state)
        else:
            vertices, kept = _pose_many(tensors, given, state, keep_rests=any(ctx.needs_input_grad))
        ctx.given, ctx.state, ctx.kept = given, state, kept
        return torch.from_numpy(vertices), torch.from_numpy(state.joints), torch.from_numpy(state.T)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor | None) -> tuple[Tensor | None, ...]:
        saved = ctx.saved_tensors  # complains if a parameter was changed in place since
        if torch.is_grad_enabled():  # create_graph=True
            return _reference_gradients(ctx, saved, gradients)
        given, state, dtype = ctx.given, ctx.state, ctx.state.row.dtype
        B, K = state.joints.shape[:2]
        V = len(ctx.tensors.cpu_arrays.basis) // 3
        by_vertices, by_joints, by_T = gradients
        by = OutputGradients(
            _array(by_vertices, (V, 3), dtype),
            _array(by_joints, (K, 3), dtype),
            _array(by_T, (K, 4, 4), dtype),
        )
        out = ParameterGradients(
            np.empty(given.coefficients.shape, dtype), np.empty((B, K, 3, 3), dtype),
            np.empty(given.axis_angle.shape, dtype), np.empty((B, 3), dtype),
        )  # fmt: skip
        backward = _unpose_few if B < _MANY_FROM else _unpose_many
        backward(ctx.tensors, given, state, ctx.kept, by, out)
        by_rotation = torch.from_numpy(out.axis_angle if len(given.axis_angle) else out.local)
        return None, torch.from_numpy(out.coefficients), by_rotation, torch.from_numpy(out.translation), None


def _parameters(coefficients: Tensor, rotation: Tensor, translation: Tensor) -> Parameters:
    values = rotation.numpy(force=True)
    axis_angle = values if values.ndim == 3 else np.empty((0, values.shape[1], 3), values.dtype)
    return Parameters(axis_angle, coefficients.numpy(force=True), translation.numpy(force=True))


def _blank_state(given: Parameters, rotation: Tensor, correctives: bool) -> BatchState:
    """Room for a batch; surfaces beyond it are padding and stay zero."""
    B, K = rotation.shape[:2]
    N = 1 + given.coefficients.shape[1] + (9 * (K - 1) if correctives else 0)
    dtype, few = given.coefficients.dtype, B < _MANY_FROM
    new, padded = (np.empty, B) if few else (np.zeros, _whole_lanes(B))
    local = new((padded, K, 3, 3), dtype)
    if rotation.ndim == 4:
        local[:B] = rotation.detach().numpy()
    return BatchState(
        new((padded, N), dtype), local, new((padded, K, 3), dtype), new((padded, K, 12), dtype),
        np.empty((B, K, 3), dtype), np.empty((B, K, 4, 4), dtype),
    )  # fmt: skip


def _few_chunks(batch: int, tensors: ModelTensors) -> int:
    return _CHUNKS if batch * tensors.cpu_arrays.basis.size > _PARALLEL_BASIS else 1


def _whole_lanes(batch: int) -> int:
    return -(-batch // lane_kernels.LANES) * lane_kernels.LANES


def _pose_few(tensors: ModelTensors, given: Parameters, state: BatchState) -> tuple[np.ndarray, Skinned]:
    """Vertices of fewer than ``_MANY_FROM`` surfaces, and what the way back needs."""
    B, model, dtype = len(state.joints), tensors.cpu_arrays, state.row.dtype
    V = len(model.basis) // 3
    vertices = np.empty((B, V, 3), dtype)
    kept = Skinned(np.empty((B, 3 * V), dtype), np.empty((B, V, 12), dtype))
    skinning_kernels.pose_few(_few_chunks(B, tensors), given, model, state, kept, vertices)
    return vertices, kept


def _unpose_few(
    tensors: ModelTensors, given: Parameters, state: BatchState, kept: Skinned, by: OutputGradients,
    out: ParameterGradients,
) -> None:  # fmt: skip
    chunks = _few_chunks(len(state.joints), tensors)
    skinning_kernels.unpose_few(chunks, given, tensors.cpu_arrays, state, kept, by, out)


def _passes(vertices: np.ndarray) -> list[slice]:
    """Which surfaces of (B, V, 3) go together: whole lanes."""
    surface_bytes = vertices.itemsize * vertices.shape[1] * 3
    step = max(1, _PASS_BYTES // surface_bytes // lane_kernels.LANES) * lane_kernels.LANES
    return [slice(first, first + step) for first in range(0, len(vertices), step)]


def _pose_many(
    tensors: ModelTensors, given: Parameters, state: BatchState, *, keep_rests: bool
) -> tuple[np.ndarray, list[np.ndarray]]:
    """Vertices of a large batch, skinned pass by pass.

    The passes' rest surfaces (3 V, surfaces) are kept for the way back; where there is none, all passes write
    to the same memory, which is mapped once.
    """
    B, K = state.joints.shape[:2]
    skinning_kernels.chain(B * K > _PARALLEL_JOINTS, given, tensors.cpu_arrays, state)
    vertices = np.empty((B, len(tensors.basis) // 3, 3), state.row.dtype)
    basis, rows = tensors.basis[:, : state.row.shape[1]], torch.from_numpy(state.row)
    rests: list[np.ndarray] = []
    scratch: Tensor | None = None
    for part in _passes(vertices):
        columns = rows[part].T
        if keep_rests or scratch is None or scratch.shape[1] != columns.shape[1]:
            scratch = basis.new_empty(len(basis), columns.shape[1])
        rest = torch.mm(basis, columns, out=scratch).numpy()
        motion = _to_lanes(state.motion[part])
        lane_kernels.pose_many(tensors.cpu_arrays, motion, rest, given.translation[part], vertices[part])
        if keep_rests:
            rests.append(rest)
    return vertices, rests


def _unpose_many(
    tensors: ModelTensors, given: Parameters, state: BatchState, rests: list[np.ndarray], by: OutputGradients,
    out: ParameterGradients,
) -> None:  # fmt: skip
    """The way back of a large batch: skinning pass by pass, then the tree."""
    basis = tensors.basis[:, : state.row.shape[1]]
    by_motion, by_row = np.zeros_like(state.motion), np.zeros_like(state.row)
    out.translation[:] = torch.from_numpy(by.vertices).sum(dim=1).numpy() if len(by.vertices) else 0
    for part, rest in zip(_passes(by.vertices), rests, strict=False):  # no pass without a gradient
        motion = _to_lanes(state.motion[part])
        by_lanes = np.zeros((_SPLITS, *motion.shape), rest.dtype)
        by_rest = np.empty_like(rest)
        lane_kernels.unpose_many(tensors.cpu_arrays, motion, rest, by.vertices[part], by_lanes, by_rest)
        by_motion[part] = _from_lanes(by_lanes.sum(axis=0))
        torch.mm(torch.from_numpy(by_rest).T, basis, out=torch.from_numpy(by_row[part]))
    B, K = state.joints.shape[:2]
    incoming = Incoming(by_motion, by_row, by.joints, by.T)
    skinning_kernels.unchain(B * K > _PARALLEL_JOINTS, given, tensors.cpu_arrays, state, incoming, out)


def _reference_gradients(
    ctx: Any, saved: tuple[Tensor, ...], gradients: tuple[Tensor | None, ...]
) -> tuple[Tensor | None, ...]:
    """The same gradients as a graph that can be differentiated again."""
    coefficients, rotation, translation = saved
    with torch.enable_grad():
        matrices = matrix_from_axis_angle(rotation) if rotation.ndim == 3 else rotation
        surface = reference_surface(ctx.tensors, coefficients, matrices, translation, ctx.correctives)
    outputs = (surface.vertices, surface.joints, surface.T_world_joint)
    used = [(value, by) for value, by in zip(outputs, gradients, strict=True) if by is not None]
    inputs = [tensor for tensor in saved if tensor.requires_grad]
    found = torch.autograd.grad(
        [value for value, _ in used], inputs, [by for _, by in used], create_graph=True, allow_unused=True
    )
    by_input = iter(found)
    coefficient, turn, move = (next(by_input) if t.requires_grad else None for t in saved)
    return None, coefficient, turn, move, None


def _array(gradient: Tensor | None, trailing: tuple[int, ...], dtype: np.dtype) -> np.ndarray:
    return np.empty((0, *trailing), dtype) if gradient is None else gradient.detach().contiguous().numpy()


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
