"""Kernels of batched posing on the CPU, forward and backward, in the dtype of their arrays.

``skeleton`` is a ``Skeleton``, ``weights`` a ``SkinWeights``, ``state`` a ``BatchState``. A joint's motion is
3 x 4: rotation row-major in 0..8, offset in 9..11. Here one surface runs after the other; ``lane_kernels`` run
large batches side by side.
"""

import math

import numpy as np
from numba import njit, prange

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
def chain_one(b, axis_angle, coefficients, translation, skeleton, state):
    """Rotations, joints, motions and the row of the basis of one surface; ``axis_angle`` may be empty."""
    K, C = len(skeleton.parents), coefficients.shape[1]
    local, rest, turned, motion = state.local[b], state.rest_joints[b], state.T[b], state.motion[b]
    state.row[b, 0] = 1
    state.row[b, 1 : 1 + C] = coefficients[b]
    for k in range(K):
        p = skeleton.parents[k]
        if len(axis_angle) > 0:
            rotation_of(axis_angle[b, k], local[k])
        for a in range(3):
            total = skeleton.joint_template[k, a]
            for s in range(C):
                total += skeleton.joint_directions[3 * k + a, s] * coefficients[b, s]
            rest[k, a] = total
        for a in range(3):
            if p < 0:
                turned[k, a, 3] = rest[k, a]
                for c in range(3):
                    turned[k, a, c] = local[k, a, c]
            else:
                x, y, z = turned[p, a, 0], turned[p, a, 1], turned[p, a, 2]
                bone = (
                    x * (rest[k, 0] - rest[p, 0])
                    + y * (rest[k, 1] - rest[p, 1])
                    + z * (rest[k, 2] - rest[p, 2])
                )
                turned[k, a, 3] = turned[p, a, 3] + bone
                for c in range(3):
                    turned[k, a, c] = x * local[k, 0, c] + y * local[k, 1, c] + z * local[k, 2, c]
            offset = turned[k, a, 3]
            for c in range(3):
                offset -= turned[k, a, c] * rest[k, c]
                motion[k, 3 * a + c] = turned[k, a, c]
                if k > 0 and state.row.shape[1] > 1 + C:
                    state.row[b, 1 + C + 9 * (k - 1) + 3 * a + c] = local[k, a, c] - (1 if a == c else 0)
            motion[k, 9 + a] = offset
    for k in range(K):
        for a in range(3):
            turned[k, a, 3] += translation[b, a]
            turned[k, 3, a] = 0
            state.joints[b, k, a] = turned[k, a, 3]
        turned[k, 3, 3] = 1


@njit(cache=True, parallel=True)
def chain(parallel, axis_angle, coefficients, translation, skeleton, state):
    """``chain_one`` for a batch."""
    B = len(coefficients)
    if parallel:
        for b in prange(B):
            chain_one(b, axis_angle, coefficients, translation, skeleton, state)
    else:
        for b in range(B):
            chain_one(b, axis_angle, coefficients, translation, skeleton, state)


@njit(cache=True)
def unchain_one(b, skeleton, state, gradients, out):
    """From gradients by motions, frames and the basis row to those by local rotations, shape and translation.

    Children come before parents. ``gradients.motion`` is used up.
    """
    K, C = len(skeleton.parents), out.coefficients.shape[1]
    local, rest, motion = state.local[b], state.rest_joints[b], state.motion[b]
    by_motion, by_joint, by_local = gradients.motion[b], np.zeros((K, 3)), out.local[b]
    placed = np.zeros((K, 3))
    turned = np.zeros((K, 3, 3))
    for k in range(K):
        for a in range(3):
            if len(gradients.T) > 0:
                placed[k, a] += gradients.T[b, k, a, 3]
                for c in range(3):
                    turned[k, a, c] += gradients.T[b, k, a, c]
            if len(gradients.joints) > 0:
                placed[k, a] += gradients.joints[b, k, a]
            out.translation[b, a] += placed[k, a]
    for k in range(K - 1, -1, -1):
        p = skeleton.parents[k]
        for a in range(3):
            placed[k, a] += by_motion[k, 9 + a]
            for c in range(3):
                turned[k, a, c] += by_motion[k, 3 * a + c] - by_motion[k, 9 + a] * rest[k, c]
                by_joint[k, c] -= motion[k, 3 * a + c] * by_motion[k, 9 + a]
        for a in range(3):
            if p < 0:
                by_joint[k, a] += placed[k, a]
                by_local[k, a] = turned[k, a]
                continue
            pulled = 0.0
            placed[p, a] += placed[k, a]
            for c in range(3):
                pulled += motion[p, 3 * c + a] * placed[k, c]
                turned[p, a, c] += placed[k, a] * (rest[k, c] - rest[p, c])
                gradient = 0.0
                for d in range(3):
                    turned[p, a, c] += turned[k, a, d] * local[k, c, d]
                    gradient += motion[p, 3 * d + a] * turned[k, d, c]
                if gradients.row.shape[1] > 1 + C:
                    gradient += gradients.row[b, 1 + C + 9 * (k - 1) + 3 * a + c]
                by_local[k, a, c] = gradient
            by_joint[k, a] += pulled
            by_joint[p, a] -= pulled
    for s in range(C):
        total = float(gradients.row[b, 1 + s])
        for k in range(K):
            for a in range(3):
                total += skeleton.joint_directions[3 * k + a, s] * by_joint[k, a]
        out.coefficients[b, s] = total


@njit(cache=True, parallel=True)
def unchain(parallel, axis_angle, skeleton, state, gradients, out):
    """``unchain_one`` for a batch, then the gradient by axis-angle unless the pose was given as matrices."""
    B, K = out.local.shape[:2]
    if parallel:
        for b in prange(B):
            unchain_one(b, skeleton, state, gradients, out)
            for k in range(K if len(axis_angle) > 0 else 0):
                axis_angle_gradient(
                    axis_angle[b, k], state.local[b, k], out.local[b, k], out.axis_angle[b, k]
                )
    else:
        for b in range(B):
            unchain_one(b, skeleton, state, gradients, out)
            for k in range(K if len(axis_angle) > 0 else 0):
                axis_angle_gradient(
                    axis_angle[b, k], state.local[b, k], out.local[b, k], out.axis_angle[b, k]
                )


@njit(cache=True, fastmath=True)
def blend_motion(i, weights, motion, blended):
    """The motion of one vertex of one surface."""
    blended[:] = 0
    for n in range(weights.starts[i], weights.starts[i + 1]):
        k, weight = weights.joints[n], weights.values[n]
        for e in range(12):
            blended[e] += weight * motion[k, e]


@njit(cache=True, fastmath=True)
def pose_few_range(first, last, basis, weights, state, translation, rest, vertices):
    """Rest surface and skinning of the vertices ``first`` to ``last``, one surface after the other."""
    blended = np.empty(12, vertices.dtype)
    N = state.row.shape[1]
    for b in range(len(vertices)):
        for i in range(first, last):
            for a in range(3):
                total = basis[3 * i + a, 0]
                for n in range(1, N):
                    total += basis[3 * i + a, n] * state.row[b, n]
                rest[b, 3 * i + a] = total
            x, y, z = rest[b, 3 * i], rest[b, 3 * i + 1], rest[b, 3 * i + 2]
            blend_motion(i, weights, state.motion[b], blended)
            for a in range(3):
                moved = blended[3 * a] * x + blended[3 * a + 1] * y + blended[3 * a + 2] * z
                vertices[b, i, a] = moved + blended[9 + a] + translation[b, a]


@njit(cache=True, parallel=True)
def pose_few(chunks, basis, weights, state, translation, rest, vertices):
    """``pose_few_range`` over all vertices, on this thread if there is one chunk."""
    V = vertices.shape[1]
    if chunks == 1:
        pose_few_range(0, V, basis, weights, state, translation, rest, vertices)
    else:
        for c in prange(chunks):
            first, last = c * V // chunks, (c + 1) * V // chunks
            pose_few_range(first, last, basis, weights, state, translation, rest, vertices)


@njit(cache=True, fastmath=True)
def unpose_few(weights, state, rest, by_vertices, by_motion, by_rest, by_translation):
    """Gradients by motions, rest surface and translation from that by the vertices."""
    blended = np.empty(12, rest.dtype)
    outer = np.empty(12, rest.dtype)
    for b in range(len(rest)):
        motion, gradient = state.motion[b], by_motion[b]
        for i in range(by_vertices.shape[1]):
            x, y, z = by_vertices[b, i, 0], by_vertices[b, i, 1], by_vertices[b, i, 2]
            blend_motion(i, weights, motion, blended)
            for c in range(3):
                by_rest[b, 3 * i + c] = blended[c] * x + blended[3 + c] * y + blended[6 + c] * z
                place = rest[b, 3 * i + c]
                outer[c], outer[3 + c], outer[6 + c] = x * place, y * place, z * place
            outer[9], outer[10], outer[11] = x, y, z
            for n in range(weights.starts[i], weights.starts[i + 1]):
                k, weight = weights.joints[n], weights.values[n]
                for e in range(12):
                    gradient[k, e] += weight * outer[e]
            by_translation[b, 0] += x
            by_translation[b, 1] += y
            by_translation[b, 2] += z
