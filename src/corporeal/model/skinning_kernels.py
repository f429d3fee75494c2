"""Kernels of batched posing on the CPU, forward and backward, in the dtype of their arrays.

``given`` is a ``Parameters``, ``model`` a ``CpuArrays``, the others are what ``batch_state`` names. A joint's
motion is 3 x 4: rotation row-major in 0..8, offset in 9..11. Surfaces run one after the other;
``lane_kernels`` run large batches side by side.
"""

import math

import numpy as np
from numba import njit, prange

from corporeal.model.batch_state import Incoming, SkinGradients

SMALL_SQUARED_ANGLE = 1e-3


@njit(cache=True)
def rodrigues(x, y, z):
    """sin(a)/a, (1-cos(a))/a^2 and (1-sin(a)/a)/a^2, by series near zero."""
    squared = x * x + y * y + z * z
    if squared < SMALL_SQUARED_ANGLE:
        sinc = 1 - squared / 6 * (1 - squared / 20 * (1 - squared / 42 * (1 - squared / 72)))
        cosc = 0.5 - squared / 24 * (1 - squared / 30 * (1 - squared / 56 * (1 - squared / 90)))
        third = (1 - squared / 20 * (1 - squared / 42 * (1 - squared / 72))) / 6
        return sinc, cosc, third
    angle = math.sqrt(squared)
    sinc = math.sin(angle) / angle
    half = math.sin(0.5 * angle)
    return sinc, 2 * half * half / squared, (1 - sinc) / squared


@njit(cache=True)
def rotation_of(axis_angle, local):
    """Rodrigues' formula, in double precision inside."""
    x, y, z = float(axis_angle[0]), float(axis_angle[1]), float(axis_angle[2])
    sinc, cosc, _ = rodrigues(x, y, z)
    cosine = 1 - cosc * (x * x + y * y + z * z)
    local[0, 0], local[1, 1], local[2, 2] = (
        cosine + cosc * x * x,
        cosine + cosc * y * y,
        cosine + cosc * z * z,
    )
    local[0, 1], local[1, 0] = cosc * x * y - sinc * z, cosc * x * y + sinc * z
    local[0, 2], local[2, 0] = cosc * x * z + sinc * y, cosc * x * z - sinc * y
    local[1, 2], local[2, 1] = cosc * y * z - sinc * x, cosc * y * z + sinc * x


@njit(cache=True)
def axis_angle_gradient(axis_angle, local, gradient, out):
    """Gradient by axis-angle from that by the matrix: the left Jacobian, transposed."""
    x, y, z = float(axis_angle[0]), float(axis_angle[1]), float(axis_angle[2])
    sinc, cosc, third = rodrigues(x, y, z)
    u, v, w = 0.0, 0.0, 0.0
    for c in range(3):
        u += gradient[2, c] * local[1, c] - gradient[1, c] * local[2, c]
        v += gradient[0, c] * local[2, c] - gradient[2, c] * local[0, c]
        w += gradient[1, c] * local[0, c] - gradient[0, c] * local[1, c]
    along = third * (x * u + y * v + z * w)
    # (sinc I + third a a^T + cosc [a])^T (u, v, w); [a]^T turns the cross product round.
    out[0] = sinc * u + along * x + cosc * (v * z - w * y)
    out[1] = sinc * v + along * y + cosc * (w * x - u * z)
    out[2] = sinc * w + along * z + cosc * (u * y - v * x)


@njit(cache=True)
def place_joint(k, p, local, rest, T, motion):
    """Frame and motion of one joint from its parent's (``p`` < 0: the root), without translation."""
    for a in range(3):
        if p < 0:
            T[k, a, 3] = rest[k, a]
            for c in range(3):
                T[k, a, c] = local[k, a, c]
        else:
            x, y, z = T[p, a, 0], T[p, a, 1], T[p, a, 2]
            T[k, a, 3] = T[p, a, 3] + (
                x * (rest[k, 0] - rest[p, 0]) + y * (rest[k, 1] - rest[p, 1]) + z * (rest[k, 2] - rest[p, 2])
            )
            for c in range(3):
                T[k, a, c] = x * local[k, 0, c] + y * local[k, 1, c] + z * local[k, 2, c]
        motion[k, 9 + a] = T[k, a, 3]
        for c in range(3):
            motion[k, 3 * a + c] = T[k, a, c]
            motion[k, 9 + a] -= T[k, a, c] * rest[k, c]


@njit(cache=True)
def chain_one(b, given, model, state):
    """Rotations, joints, motions and the row of the basis of one surface."""
    K, C = len(model.parents), given.coefficients.shape[1]
    local, rest, T = state.local[b], state.rest_joints[b], state.T[b]
    state.row[b, 0] = 1
    for s in range(C):
        state.row[b, 1 + s] = given.coefficients[b, s]
    for k in range(K):
        if len(given.axis_angle) > 0:
            rotation_of(given.axis_angle[b, k], local[k])
        for a in range(3):
            rest[k, a] = model.joint_template[k, a]
            for s in range(C):
                rest[k, a] += model.joint_directions[3 * k + a, s] * given.coefficients[b, s]
        place_joint(k, model.parents[k], local, rest, T, state.motion[b])
        if k > 0 and state.row.shape[1] > 1 + C:
            first = 1 + C + 9 * (k - 1)
            for e in range(9):
                state.row[b, first + e] = local[k, e // 3, e % 3] - (1 if e % 4 == 0 else 0)
    for k in range(K):
        for a in range(3):
            T[k, a, 3] += given.translation[b, a]
            T[k, 3, a] = 0
            state.joints[b, k, a] = T[k, a, 3]
        T[k, 3, 3] = 1


@njit(cache=True, parallel=True)
def chain(parallel, given, model, state):
    """``chain_one`` for a batch."""
    B = len(given.coefficients)
    if parallel:
        for b in prange(B):
            chain_one(b, given, model, state)
    else:
        for b in range(B):
            chain_one(b, given, model, state)


@njit(cache=True)
def frame_gradients(b, gradients, by_frame, by_translation):
    """What flows in from joints and frames; each part may be absent."""
    for k in range(len(by_frame)):
        for a in range(3):
            if len(gradients.T) > 0:
                for c in range(4):
                    by_frame[k, a, c] += gradients.T[b, k, a, c]
            if len(gradients.joints) > 0:
                by_frame[k, a, 3] += gradients.joints[b, k, a]
            by_translation[a] += by_frame[k, a, 3]


@njit(cache=True)
def unplace_joint(k, p, local, rest, motion, by_frame, by_joint, by_local):
    """Reverse of ``place_joint``: from a joint's gradients to its parent's and to its local rotation."""
    for a in range(3):
        if p < 0:
            by_joint[k, a] += by_frame[k, a, 3]
            for c in range(3):
                by_local[k, a, c] = by_frame[k, a, c]
            continue
        pulled = 0.0
        by_frame[p, a, 3] += by_frame[k, a, 3]
        for c in range(3):
            pulled += motion[p, 3 * c + a] * by_frame[k, c, 3]
            by_frame[p, a, c] += by_frame[k, a, 3] * (rest[k, c] - rest[p, c])
            by_element = 0.0
            for d in range(3):
                by_frame[p, a, c] += by_frame[k, a, d] * local[k, c, d]
                by_element += motion[p, 3 * d + a] * by_frame[k, d, c]
            by_local[k, a, c] = by_element
        by_joint[k, a] += pulled
        by_joint[p, a] -= pulled


@njit(cache=True)
def unchain_one(b, given, model, state, gradients, out):
    """From gradients by motions, frames and the basis row to those by the parameters.

    Children come before parents, so that a joint's gradient is complete when it is passed on.
    """
    K, C = len(model.parents), given.coefficients.shape[1]
    local, rest, motion, by_local = state.local[b], state.rest_joints[b], state.motion[b], out.local[b]
    by_motion, by_frame, by_joint = gradients.motion[b], np.zeros((K, 3, 4)), np.zeros((K, 3))
    frame_gradients(b, gradients, by_frame, out.translation[b])
    for k in range(K - 1, -1, -1):
        for a in range(3):
            by_frame[k, a, 3] += by_motion[k, 9 + a]
            for c in range(3):
                by_frame[k, a, c] += by_motion[k, 3 * a + c] - by_motion[k, 9 + a] * rest[k, c]
                by_joint[k, c] -= motion[k, 3 * a + c] * by_motion[k, 9 + a]
        unplace_joint(k, model.parents[k], local, rest, motion, by_frame, by_joint, by_local)
        if k > 0 and gradients.row.shape[1] > 1 + C:
            for e in range(9):
                by_local[k, e // 3, e % 3] += gradients.row[b, 1 + C + 9 * (k - 1) + e]
        if len(given.axis_angle) > 0:
            axis_angle_gradient(given.axis_angle[b, k], local[k], by_local[k], out.axis_angle[b, k])
    for s in range(C):
        total = float(gradients.row[b, 1 + s])
        for k in range(K):
            for a in range(3):
                total += model.joint_directions[3 * k + a, s] * by_joint[k, a]
        out.coefficients[b, s] = total


@njit(cache=True, parallel=True)
def unchain(parallel, given, model, state, gradients, out):
    """``unchain_one`` for a batch."""
    B = len(given.coefficients)
    if parallel:
        for b in prange(B):
            unchain_one(b, given, model, state, gradients, out)
    else:
        for b in range(B):
            unchain_one(b, given, model, state, gradients, out)


@njit(cache=True, fastmath=True)
def add_motion(blended, weight, motion):
    """``blended + weight * motion``, twelve numbers.

    A tuple stays in registers. An array in its place went through memory for every joint: skinning of a hand
    took twice as long.
    """
    return (
        blended[0] + weight * motion[0], blended[1] + weight * motion[1], blended[2] + weight * motion[2],
        blended[3] + weight * motion[3], blended[4] + weight * motion[4], blended[5] + weight * motion[5],
        blended[6] + weight * motion[6], blended[7] + weight * motion[7], blended[8] + weight * motion[8],
        blended[9] + weight * motion[9], blended[10] + weight * motion[10], blended[11] + weight * motion[11],
    )  # fmt: skip


@njit(cache=True, fastmath=True)
def skin_vertex(i, model, motion, rest, move, kept, vertex):
    """The posed place of one vertex; ``kept`` gets its motion."""
    zero = rest.dtype.type(0)
    m = (zero, zero, zero, zero, zero, zero, zero, zero, zero, zero, zero, zero)
    for n in range(model.weight_starts[i], model.weight_starts[i + 1]):
        m = add_motion(m, model.weight_values[n], motion[model.weight_joints[n]])
    x, y, z = rest[3 * i], rest[3 * i + 1], rest[3 * i + 2]
    vertex[0] = m[0] * x + m[1] * y + m[2] * z + m[9] + move[0]
    vertex[1] = m[3] * x + m[4] * y + m[5] * z + m[10] + move[1]
    vertex[2] = m[6] * x + m[7] * y + m[8] * z + m[11] + move[2]
    kept[0], kept[1], kept[2], kept[3], kept[4], kept[5] = m[0], m[1], m[2], m[3], m[4], m[5]
    kept[6], kept[7], kept[8], kept[9], kept[10], kept[11] = m[6], m[7], m[8], m[9], m[10], m[11]


@njit(cache=True, fastmath=True)
def pose_range(first, last, given, model, state, kept, vertices):
    """Rest surface and skinning of the vertices ``first`` to ``last``, one surface after the other."""
    N, zero = state.row.shape[1], state.row.dtype.type(0)
    for b in range(len(vertices)):
        rest, move = kept.rest[b], given.translation[b]
        for row in range(3 * first, 3 * last):
            total = zero
            for n in range(N):  # from the column that begins a cache line
                total += model.basis[row, n] * state.row[b, n]
            rest[row] = total
        for i in range(first, last):
            skin_vertex(i, model, state.motion[b], rest, move, kept.blended[b, i], vertices[b, i])


@njit(cache=True, parallel=True)
def pose_few(chunks, given, model, state, kept, vertices):
    """Joints, rest surface and skinning, on this thread if there is one chunk."""
    B, V = vertices.shape[:2]
    for b in range(B):
        chain_one(b, given, model, state)
    if chunks == 1:
        pose_range(0, V, given, model, state, kept, vertices)
    else:
        for c in prange(chunks):
            pose_range(c * V // chunks, (c + 1) * V // chunks, given, model, state, kept, vertices)


@njit(cache=True, fastmath=True)
def gather_motion(k, model, rest, by_vertices, by_motion):
    """Gradient by the motion of joint ``k``: the sum over its vertices.

    By joint, because twelve sums then stay in registers; by vertex they went through memory, three times as
    slow.
    """
    zero = rest.dtype.type(0)
    m = (zero, zero, zero, zero, zero, zero, zero, zero, zero, zero, zero, zero)
    for n in range(model.vertex_starts[k], model.vertex_starts[k + 1]):
        i = model.weight_vertices[n]
        x, y, z = by_vertices[i, 0], by_vertices[i, 1], by_vertices[i, 2]
        p, q, r = rest[3 * i], rest[3 * i + 1], rest[3 * i + 2]
        outer = (x * p, x * q, x * r, y * p, y * q, y * r, z * p, z * q, z * r, x, y, z)
        m = add_motion(m, model.vertex_values[n], outer)
    by_motion[0], by_motion[1], by_motion[2], by_motion[3], by_motion[4], by_motion[5] = m[:6]
    by_motion[6], by_motion[7], by_motion[8], by_motion[9], by_motion[10], by_motion[11] = m[6:]


@njit(cache=True, fastmath=True)
def gather_row(first, last, model, kept, by_vertices, by_row):
    """Gradient by the basis row of one surface from the vertices ``first`` to ``last``."""
    for i in range(first, last):
        x, y, z = by_vertices[i, 0], by_vertices[i, 1], by_vertices[i, 2]
        blended = kept[i]
        u = blended[0] * x + blended[3] * y + blended[6] * z
        v = blended[1] * x + blended[4] * y + blended[7] * z
        w = blended[2] * x + blended[5] * y + blended[8] * z
        for n in range(len(by_row)):
            by_row[n] += (
                u * model.basis[3 * i, n] + v * model.basis[3 * i + 1, n] + w * model.basis[3 * i + 2, n]
            )


@njit(cache=True)
def unpose_part(c, chunks, model, kept, by_vertices, gradients):
    """Every ``chunks``-th joint from ``c`` on, and the basis row by the vertices of part ``c``."""
    V, K = by_vertices.shape[1], gradients.motion.shape[1]
    first, last = c * V // chunks, (c + 1) * V // chunks
    for b in range(len(by_vertices)):
        for k in range(c, K, chunks):
            gather_motion(k, model, kept.rest[b], by_vertices[b], gradients.motion[b, k])
        gather_row(first, last, model, kept.blended[b], by_vertices[b], gradients.row[c, b])


@njit(cache=True, parallel=True)
def unpose_parts(chunks, model, kept, by_vertices, gradients):
    """``unpose_part`` by several threads."""
    for c in prange(chunks):
        unpose_part(c, chunks, model, kept, by_vertices, gradients)


@njit(cache=True)
def unpose_few(chunks, given, model, state, kept, by, out):
    """The way back of a few surfaces, from gradients by vertices, joints and frames; each may be empty."""
    gradients = SkinGradients(
        np.zeros_like(state.motion), np.zeros((chunks, *state.row.shape), state.row.dtype)
    )
    if chunks == 1:
        unpose_part(0, 1, model, kept, by.vertices, gradients)
    else:
        unpose_parts(chunks, model, kept, by.vertices, gradients)
    for c in range(1, chunks):
        gradients.row[0] += gradients.row[c]
    out.translation[:] = 0
    for b in range(len(by.vertices)):
        for i in range(by.vertices.shape[1]):
            for a in range(3):
                out.translation[b, a] += by.vertices[b, i, a]
    incoming = Incoming(gradients.motion, gradients.row[0], by.joints, by.T)
    for b in range(len(state.motion)):
        unchain_one(b, given, model, state, incoming, out)
