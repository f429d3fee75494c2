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
    Band,
    BandGradients,
    BatchState,
    Incoming,
    OutputGradients,
    ParameterGradients,
    Parameters,
    Skinned,
)
from corporeal.model.pose import FullPose
from corporeal.model.reference import ModelTensors, PosedSurface, reference_surface

# Batches from here on are posed LANES at a time. Padding costs smaller ones more than it gains: 4 bodies take
# 1.8 times the time, 8 the same, 12 take 0.8 of it.
_MANY_FROM = 8
# Waking a second thread takes about 80 us: numbers of the basis, and joints, from which it pays.
_PARALLEL_BASIS = 3_000_000
_PARALLEL_JOINTS = 1_000
_CHUNKS = 16
# A product of matrices writes the rest surfaces of a large batch, a band of vertices at a time, and they are
# skinned while cached. Bands of 0.5, 1, 2 and 8 MB took 1.18, 1.08, 1.01 and 0.99 of the time for 256 bodies.
# Bands of surfaces, not of vertices, make the product narrow; all at once maps 32 MB for each call.
_BAND_BYTES = 4_000_000


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
        kept: Skinned | Tensor
        if len(state.joints) < _MANY_FROM:
            vertices, kept = _pose_few(tensors, given, state)
        else:
            vertices, kept = _pose_many(tensors, given, state, keep_rest=any(ctx.needs_input_grad))
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


def _bands(vertex_count: int, row_bytes: int) -> list[tuple[int, int]]:
    """Which vertices go together, by the bytes of one coordinate of all surfaces."""
    step = max(lane_kernels.TILE, _BAND_BYTES // (3 * row_bytes))
    return [(first, min(first + step, vertex_count)) for first in range(0, vertex_count, step)]


def _pose_many(
    tensors: ModelTensors, given: Parameters, state: BatchState, *, keep_rest: bool
) -> tuple[np.ndarray, Tensor]:
    """Vertices of a large batch, and its rest surfaces (3 V, Bp) if they are to be kept for the way back.

    Where there is none, all bands write to the same memory.
    """
    B, K = state.joints.shape[:2]
    skinning_kernels.chain(B * K > _PARALLEL_JOINTS, given, tensors.cpu_arrays, state)
    V = len(tensors.basis) // 3
    vertices = np.empty((B, V, 3), state.row.dtype)
    columns, motion = torch.from_numpy(state.row).T, _to_lanes(state.motion)
    basis = tensors.basis[:, : len(columns)]
    bands = _bands(V, columns.shape[1] * vertices.itemsize)
    rests = basis.new_empty(3 * (V if keep_rest else bands[0][1]), columns.shape[1])
    for first, last in bands:
        rest = rests[3 * first : 3 * last] if keep_rest else rests[: 3 * (last - first)]
        torch.mm(basis[3 * first : 3 * last], columns, out=rest)
        band = Band(first, last, rest.numpy())
        lane_kernels.pose_many(tensors.cpu_arrays, motion, band, given.translation, vertices)
    return vertices, rests


def _unpose_many(
    tensors: ModelTensors, given: Parameters, state: BatchState, rests: Tensor, by: OutputGradients,
    out: ParameterGradients,
) -> None:  # fmt: skip
    """The way back of a large batch: skinning band by band, then the tree."""
    by_columns = rests.new_zeros(state.row.shape[::-1])
    motion = _to_lanes(state.motion)
    by_lanes = torch.zeros((lane_kernels.SPLITS, *motion.shape), dtype=rests.dtype)  # on a cache line
    out.translation[:] = torch.from_numpy(by.vertices).sum(dim=1).numpy() if len(by.vertices) else 0
    bands = _bands(len(rests) // 3, rests.shape[1] * rests.element_size()) if len(by.vertices) else []
    by_rests = rests.new_empty(3 * bands[0][1] if bands else 0, rests.shape[1])
    for first, last in bands:
        rows = slice(3 * first, 3 * last)
        by_rest = by_rests[: 3 * (last - first)]
        band = Band(first, last, rests[rows].numpy())
        gradients = BandGradients(by.vertices, by_lanes.numpy(), by_rest.numpy())
        lane_kernels.unpose_many(tensors.cpu_arrays, motion, band, gradients)
        by_columns.addmm_(tensors.basis[rows, : len(by_columns)].T, by_rest)
    by_motion = _from_lanes(by_lanes.sum(dim=0).numpy())
    B, K = state.joints.shape[:2]
    incoming = Incoming(by_motion, by_columns.T.contiguous().numpy(), by.joints, by.T)
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
