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
_SPLITS = 8  # of the vertices on the way back, each with its own sums
# A pass writes the rest surfaces of a part of a large batch by a matrix product and skins them. Its size
# bounds the memory beside the result: passes of 16, 8 and 4 MB were measured to be 1.1, 1.3 and 1.8 times as
# slow as one of 64 MB for 256 bodies, because the product becomes narrow.
_PASS_BYTES = 64_000_000


class Parameters(NamedTuple):
    """What a batch is posed by; ``axis_angle`` is empty where the pose came as matrices."""

    axis_angle: Float[np.ndarray, "b K 3"]
    coefficients: Float[np.ndarray, "B C"]
    translation: Float[np.ndarray, "B 3"]


class BatchState(NamedTuple):
    """What the kernels keep of a batch, for the backward pass too; Bp is B, padded to whole lanes."""

    row: Float[np.ndarray, "Bp N"]  # 1, coefficients, pose feature: the rest surface is basis @ row
    local: Float[np.ndarray, "Bp K 3 3"]
    rest_joints: Float[np.ndarray, "Bp K 3"]
    motion: Float[np.ndarray, "Bp K 12"]
    joints: Float[np.ndarray, "B K 3"]
    T: Float[np.ndarray, "B K 4 4"]


class SkinGradients(NamedTuple):
    """Gradients by what skinning used, in parts that were summed by different threads."""

    motion: Float[np.ndarray, "c Bp K 12"]
    row: Float[np.ndarray, "c Bp N"]
    translation: Float[np.ndarray, "c B 3"]


class Incoming(NamedTuple):
    """Gradients that the tree passes on; those by joints and frames are empty where there are none."""

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
        model, given = tensors.cpu_arrays, _parameters(coefficients, rotation, translation)
        B, K = rotation.shape[:2]
        few = B < _MANY_FROM
        joints, T_world_joint = torch.empty(B, K, 3, dtype=rotation.dtype), rotation.new_empty(B, K, 4, 4)
        vertices = rotation.new_empty(B, len(model.basis) // 3, 3)
        N = model.basis.shape[1] if correctives else 1 + coefficients.shape[1]
        state = _blank_state(rotation, N, B if few else _whole_lanes(B), joints, T_world_joint)
        if few:
            rests = [np.empty((B, len(model.basis)), state.row.dtype)]
            chunks = _few_chunks(B, tensors)
            skinning_kernels.pose_few(chunks, given, model, state, rests[0], vertices.numpy())
        else:
            skinning_kernels.chain(B * K > _PARALLEL_JOINTS, given, model, state)
            rests = _pose_many(tensors, given, state, vertices.numpy(), keep_rests=any(ctx.needs_input_grad))
        ctx.given, ctx.state, ctx.rests = given, state, rests
        return vertices, joints, T_world_joint

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor | None) -> tuple[Tensor | None, ...]:
        saved = ctx.saved_tensors  # complains if a parameter was changed in place since
        if torch.is_grad_enabled():  # create_graph=True
            return _reference_gradients(ctx, saved, gradients)
        given, state, (by_vertices, by_joints, by_T) = ctx.given, ctx.state, gradients
        by_motion, by_row, by_translation = _skinning_gradients(ctx, by_vertices)
        B, K = state.joints.shape[:2]
        dtype = by_row.dtype
        out = ParameterGradients(
            np.empty(given.coefficients.shape, dtype), np.empty((B, K, 3, 3), dtype),
            np.empty(given.axis_angle.shape, dtype), by_translation,
        )  # fmt: skip
        incoming = Incoming(
            by_motion, by_row, _array(by_joints, (0, K, 3), dtype), _array(by_T, (0, K, 4, 4), dtype)
        )
        skinning_kernels.unchain(
            B * K > _PARALLEL_JOINTS, given, ctx.tensors.cpu_arrays, state, incoming, out
        )
        by_rotation = out.axis_angle if len(given.axis_angle) else out.local
        found = (torch.from_numpy(array) for array in (out.coefficients, by_rotation, out.translation))
        return None, *found, None


def _parameters(coefficients: Tensor, rotation: Tensor, translation: Tensor) -> Parameters:
    values = rotation.detach().numpy()
    axis_angle = values if values.ndim == 3 else np.empty((0, values.shape[1], 3), values.dtype)
    return Parameters(axis_angle, coefficients.detach().numpy(), translation.detach().numpy())


def _blank_state(rotation: Tensor, N: int, padded: int, joints: Tensor, T_world_joint: Tensor) -> BatchState:
    """Room for a batch; surfaces beyond it are padding and stay zero."""
    values = rotation.detach().numpy()
    B, K, dtype = *values.shape[:2], values.dtype
    new = np.empty if padded == B else np.zeros
    local = new((padded, K, 3, 3), dtype)
    if values.ndim == 4:
        local[:B] = values
    return BatchState(
        new((padded, N), dtype), local, new((padded, K, 3), dtype), new((padded, K, 12), dtype),
        joints.numpy(), T_world_joint.numpy(),
    )  # fmt: skip


def _few_chunks(batch: int, tensors: ModelTensors) -> int:
    return _CHUNKS if batch * tensors.basis.numel() > _PARALLEL_BASIS else 1


def _whole_lanes(batch: int) -> int:
    return -(-batch // lane_kernels.LANES) * lane_kernels.LANES


def _skinning_gradients(ctx: Any, by_vertices: Tensor | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gradients by motions, basis row and translation from that by the vertices."""
    state, model = ctx.state, ctx.tensors.cpu_arrays
    B, dtype = len(state.joints), state.row.dtype
    if by_vertices is None:
        return np.zeros_like(state.motion), np.zeros_like(state.row), np.zeros((B, 3), dtype)
    pull = by_vertices.contiguous()
    if B >= _MANY_FROM:
        return *_unpose_many(ctx.tensors, state, ctx.rests, pull.numpy()), pull.sum(dim=1).numpy()
    chunks = _few_chunks(B, ctx.tensors)
    shapes = (state.motion.shape, state.row.shape, (B, 3))
    parts = SkinGradients(*(np.zeros((chunks, *shape), dtype) for shape in shapes))
    skinning_kernels.unpose_few(model, state, ctx.rests[0], pull.numpy(), parts)
    if chunks == 1:
        return parts.motion[0], parts.row[0], parts.translation[0]
    return parts.motion.sum(axis=0), parts.row.sum(axis=0), parts.translation.sum(axis=0)


def _passes(vertices: np.ndarray) -> list[slice]:
    """Which surfaces of (B, V, 3) go together: whole lanes."""
    surface_bytes = vertices.itemsize * vertices.shape[1] * 3
    step = max(1, _PASS_BYTES // surface_bytes // lane_kernels.LANES) * lane_kernels.LANES
    return [slice(first, first + step) for first in range(0, len(vertices), step)]


def _pose_many(
    tensors: ModelTensors, given: Parameters, state: BatchState, vertices: np.ndarray, *, keep_rests: bool
) -> list[np.ndarray]:
    """Skin a large batch, pass by pass.

    The passes' rest surfaces (3 V, surfaces) are kept for the way back; where there is none, all passes write
    to the same memory, which is mapped once.
    """
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
    return rests


def _unpose_many(
    tensors: ModelTensors, state: BatchState, rests: list[np.ndarray], by_vertices: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Gradients by motions and basis row of a large batch, pass by pass."""
    basis = tensors.basis[:, : state.row.shape[1]]
    by_motion, by_row = np.empty_like(state.motion), np.empty_like(state.row)
    for part, rest in zip(_passes(by_vertices), rests, strict=True):
        motion = _to_lanes(state.motion[part])
        by_lanes = np.zeros((_SPLITS, *motion.shape), rest.dtype)
        by_rest = np.empty_like(rest)
        lane_kernels.unpose_many(tensors.cpu_arrays, motion, rest, by_vertices[part], by_lanes, by_rest)
        by_motion[part] = _from_lanes(by_lanes.sum(axis=0))
        torch.mm(torch.from_numpy(by_rest).T, basis, out=torch.from_numpy(by_row[part]))
    return by_motion, by_row


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


def _array(gradient: Tensor | None, empty: tuple[int, ...], dtype: np.dtype) -> np.ndarray:
    return np.empty(empty, dtype) if gradient is None else gradient.detach().contiguous().numpy()


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
