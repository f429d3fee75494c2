"""Kernels of the closed-form evaluation and Jacobian of one posed surface, in float64.

``arrays`` is a ``KernelArrays``, ``joints`` a ``JointState`` and ``slopes`` a ``JointSlopes``. What is called
per vertex is inlined by numba: a call hands over every field of every array of a named tuple, a hundred
numbers, which was four fifths of the time of a posed surface; LLVM inlines only the smallest functions.
"""

import math

import numpy as np
from numba import njit, prange

# Taylor series below this squared angle are exact to the last bit.
SMALL_SQUARED_ANGLE = 1e-3


@njit(cache=True)
def rotation_and_left_jacobian(vector, rotation, left):
    """R(vector), and J with R(vector + d) ~ exp(J d) R(vector); smooth at every angle."""
    squared = vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2]
    if squared < SMALL_SQUARED_ANGLE:
        sinc = 1 - squared / 6 * (1 - squared / 20 * (1 - squared / 42 * (1 - squared / 72)))
        cosc = 0.5 - squared / 24 * (1 - squared / 30 * (1 - squared / 56 * (1 - squared / 90)))
        third = (1 - squared / 20 * (1 - squared / 42 * (1 - squared / 72))) / 6
    else:
        angle = math.sqrt(squared)
        sinc = math.sin(angle) / angle
        half = math.sin(0.5 * angle)
        cosc = 2 * half * half / squared
        third = (1 - sinc) / squared
    cosine = 1 - cosc * squared
    for a in range(3):
        for b in range(3):
            rotation[a, b] = cosc * vector[a] * vector[b]
            left[a, b] = third * vector[a] * vector[b]
        rotation[a, a] += cosine
        left[a, a] += sinc
    for a, b, c in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        rotation[a, b] -= sinc * vector[c]
        rotation[b, a] += sinc * vector[c]
        left[a, b] -= cosc * vector[c]
        left[b, a] += cosc * vector[c]


@njit(cache=True)
def rest_joint(arrays, coefficients, k, a):
    """One coordinate of a joint of the shaped body at the zero pose."""
    total = arrays.joint_template[k, a]
    for s in range(len(coefficients)):
        total += arrays.joint_directions[k, a, s] * coefficients[s]
    return total


@njit(cache=True)
def chain_joints(arrays, coefficients, pose, joints):
    """Fill ``joints`` down the tree; an empty ``joints.feature`` leaves the pose correctives out."""
    for k in range(len(arrays.parents)):
        p = arrays.parents[k]
        local, turned, placed, rest = joints.local[k], joints.turned, joints.placed, joints.rest
        rotation_and_left_jacobian(pose[k], local, joints.left[k])
        for a in range(3):
            rest[k, a] = rest_joint(arrays, coefficients, k, a)
        if p < 0:
            turned[k] = local
            placed[k] = rest[k]
        else:
            for a in range(3):
                placed[k, a] = placed[p, a]
                for b in range(3):
                    placed[k, a] += turned[p, a, b] * (rest[k, b] - rest[p, b])
                    turned[k, a, b] = 0.0
                    for c in range(3):
                        turned[k, a, b] += turned[p, a, c] * local[c, b]
        for a in range(3):
            joints.motion[k, 9 + a] = placed[k, a]
            for b in range(3):
                joints.motion[k, 3 * a + b] = turned[k, a, b]
                joints.motion[k, 9 + a] -= turned[k, a, b] * rest[k, b]
                if k > 0 and len(joints.feature) > 0:
                    joints.feature[k - 1, 3 * a + b] = local[a, b] - (1.0 if a == b else 0.0)


@njit(cache=True, fastmath=True, inline="always")
def shaped_coordinate(row, arrays, coefficients):
    """One coordinate of one vertex with its shape, without pose correctives."""
    total = arrays.template[row]
    for s in range(len(coefficients)):
        total += arrays.directions[row, s] * coefficients[s]
    return total


@njit(cache=True, fastmath=True, inline="always")
def corrective(i, arrays, feature):
    """What the pose adds to one vertex before skinning; ``feature`` (K - 1, 9).

    A hand, whose joints correct all vertices, takes 1.2 times as long as with one dot product per coordinate,
    a body a ninth. Gathering the features of the joints for one dot product was slower than loops of nine.
    """
    x, y, z = 0.0, 0.0, 0.0
    for n in range(arrays.corrected_starts[i], arrays.corrected_starts[i + 1]):
        m = arrays.corrected_joints[n] - 1
        for e in range(9):
            x += arrays.correctives[n, 0, e] * feature[m, e]
            y += arrays.correctives[n, 1, e] * feature[m, e]
            z += arrays.correctives[n, 2, e] * feature[m, e]
    return x, y, z


@njit(cache=True, fastmath=True, inline="always")
def rest_point(i, arrays, coefficients, feature):
    """One vertex before skinning."""
    x = shaped_coordinate(3 * i, arrays, coefficients)
    y = shaped_coordinate(3 * i + 1, arrays, coefficients)
    z = shaped_coordinate(3 * i + 2, arrays, coefficients)
    if len(feature) > 0:
        u, v, w = corrective(i, arrays, feature)
        return x + u, y + v, z + w
    return x, y, z


@njit(cache=True, fastmath=True, inline="always")
def blend_motion(i, arrays, motion, blended):
    """The 3 x 4 motion of one vertex: rotation row-major, then offset."""
    blended[:] = 0.0
    for n in range(arrays.weight_starts[i], arrays.weight_starts[i + 1]):
        k = arrays.weight_joints[n]
        weight = arrays.weight_values[n]
        for e in range(12):
            blended[e] += weight * motion[k, e]


@njit(cache=True, fastmath=True)
def pose_range(first, last, arrays, coefficients, joints, translation, vertices):
    """Blend shapes and linear blend skinning of the vertices ``first`` to ``last``."""
    blended = np.empty(12)
    for i in range(first, last):
        x, y, z = rest_point(i, arrays, coefficients, joints.feature)
        blend_motion(i, arrays, joints.motion, blended)
        for a in range(3):
            moved = blended[3 * a] * x + blended[3 * a + 1] * y + blended[3 * a + 2] * z + blended[9 + a]
            vertices[i, a] = moved + translation[a]


@njit(cache=True, parallel=True)
def pose_vertices(chunks, arrays, coefficients, joints, translation, vertices):
    """All vertices, on this thread if there is one chunk."""
    V = len(vertices)
    if chunks == 1:
        pose_range(0, V, arrays, coefficients, joints, translation, vertices)
    else:
        for c in prange(chunks):
            pose_range(
                c * V // chunks, (c + 1) * V // chunks, arrays, coefficients, joints, translation, vertices
            )


@njit(cache=True)
def joint_slopes(arrays, joints, directions, slopes, jacobian):
    """Fill ``slopes`` and the joints' Jacobian; ``directions`` (K, 3, n) are those of the rest joints."""
    for k in range(len(arrays.parents)):
        p = arrays.parents[k]
        for b in range(3):
            u, v, w = joints.left[k, 0, b], joints.left[k, 1, b], joints.left[k, 2, b]
            for a in range(3):
                slopes.turning[k, a, b] = v * joints.local[k, 2, a] - w * joints.local[k, 1, a]
                slopes.turning[k, 3 + a, b] = w * joints.local[k, 0, a] - u * joints.local[k, 2, a]
                slopes.turning[k, 6 + a, b] = u * joints.local[k, 1, a] - v * joints.local[k, 0, a]
                slopes.spin[k, a, b] = joints.left[k, a, b]
                if p >= 0:
                    turned = joints.turned[p]
                    slopes.spin[k, a, b] = turned[a, 0] * u + turned[a, 1] * v + turned[a, 2] * w
            jacobian[k, b, b] = 1.0
        m = p
        while m >= 0:
            x, y, z = joints.placed[k] - joints.placed[m]
            for b in range(3):
                u, v, w = slopes.spin[m, 0, b], slopes.spin[m, 1, b], slopes.spin[m, 2, b]
                jacobian[k, 0, 3 + 3 * m + b] = v * z - w * y
                jacobian[k, 1, 3 + 3 * m + b] = w * x - u * z
                jacobian[k, 2, 3 + 3 * m + b] = u * y - v * x
            m = arrays.parents[m]
        joint_shape_slopes(k, p, joints.turned, directions, slopes.shift, jacobian)


@njit(cache=True)
def joint_shape_slopes(k, p, turned, directions, shift, jacobian):
    """Derivative of joint ``k`` and of its motion's offset by shape and expression; parents come first."""
    out = 3 + 3 * len(turned)
    for s in range(directions.shape[2]):
        for a in range(3):
            moved, carried = directions[k, a, s], 0.0
            if p >= 0:
                moved = jacobian[p, a, out + s]
            for b in range(3):
                carried += turned[k, a, b] * directions[k, b, s]
                if p >= 0:
                    moved += turned[p, a, b] * (directions[k, b, s] - directions[p, b, s])
            jacobian[k, a, out + s] = moved
            shift[k, a, s] = moved - carried


@njit(cache=True, fastmath=True, inline="always")
def carry(i, arrays, motion, rest, carried):
    """What every joint carries of a vertex, into ``carried`` (K, 4): weighted posed position, and weight."""
    x, y, z = rest
    for n in range(arrays.weight_starts[i], arrays.weight_starts[i + 1]):
        k = arrays.weight_joints[n]
        w = arrays.weight_values[n]
        for a in range(3):
            carried[k, a] = w * (
                motion[k, 3 * a] * x + motion[k, 3 * a + 1] * y + motion[k, 3 * a + 2] * z + motion[k, 9 + a]
            )
        carried[k, 3] = w


@njit(cache=True, fastmath=True, inline="always")
def rotation_columns(i, arrays, layout, placed, spin, carried, jacobian):
    """Derivative by every joint's rotation: cross product with what its descendants carry of the vertex.

    ``jacobian`` (3, Q) is that of the vertex, ``layout[m]`` the first column of joint m.

    Children come before parents, so that each joint's share is complete when it is used; ``carried`` is left
    zero for the next vertex.
    """
    for n in range(arrays.chain_starts[i + 1] - 1, arrays.chain_starts[i] - 1, -1):
        m = arrays.chain_joints[n]
        weight = carried[m, 3]
        x = carried[m, 0] - weight * placed[m, 0]
        y = carried[m, 1] - weight * placed[m, 1]
        z = carried[m, 2] - weight * placed[m, 2]
        column = layout[m]
        for b in range(3):
            u, v, w = spin[m, 0, b], spin[m, 1, b], spin[m, 2, b]
            jacobian[0, column + b] = v * z - w * y
            jacobian[1, column + b] = w * x - u * z
            jacobian[2, column + b] = u * y - v * x
        p = arrays.parents[m]
        for a in range(4):
            if p >= 0:
                carried[p, a] += carried[m, a]
            carried[m, a] = 0.0


@njit(cache=True, fastmath=True, inline="always")
def corrective_columns(i, arrays, layout, turning, blended, jacobian):
    """The pose correctives' own derivative, added to the columns of their joints."""
    for n in range(arrays.corrected_starts[i], arrays.corrected_starts[i + 1]):
        m = arrays.corrected_joints[n]
        for b in range(3):
            x, y, z = 0.0, 0.0, 0.0
            for e in range(9):
                x += arrays.correctives[n, 0, e] * turning[m, e, b]
                y += arrays.correctives[n, 1, e] * turning[m, e, b]
                z += arrays.correctives[n, 2, e] * turning[m, e, b]
            for a in range(3):
                moved = blended[3 * a] * x + blended[3 * a + 1] * y + blended[3 * a + 2] * z
                jacobian[a, layout[m] + b] += moved


@njit(cache=True, fastmath=True, inline="always")
def shape_columns(i, arrays, columns, shift, blended, jacobian):
    """Derivative by shape and expression: directions turned, plus what they move the joints by."""
    out = jacobian.shape[1] - len(columns)
    for a in range(3):
        for s in range(len(columns)):
            c = columns[s]
            jacobian[a, out + s] = (
                blended[3 * a] * arrays.directions[3 * i, c]
                + blended[3 * a + 1] * arrays.directions[3 * i + 1, c]
                + blended[3 * a + 2] * arrays.directions[3 * i + 2, c]
            )
        for n in range(arrays.weight_starts[i], arrays.weight_starts[i + 1]):
            k = arrays.weight_joints[n]
            w = arrays.weight_values[n]
            for s in range(len(columns)):
                jacobian[a, out + s] += w * shift[k, a, s]


@njit(cache=True, fastmath=True)
def linearise_range(first, last, arrays, chosen, coefficients, joints, slopes, jacobian):
    """Jacobian of the entries ``first`` to ``last`` of the vertices that ``chosen`` names.

    ``chosen`` is a ``Chosen``: the vertices, the first column of every joint, and the directions.
    """
    K = len(arrays.parents)
    carried, blended = np.zeros((K, 4)), np.empty(12)
    for entry in range(first, last):
        i, own = chosen.vertices[entry], jacobian[entry]
        rest = rest_point(i, arrays, coefficients, joints.feature)
        for a in range(3):
            for q in range(own.shape[1]):
                own[a, q] = 0.0
            own[a, a] = 1.0
        blend_motion(i, arrays, joints.motion, blended)
        carry(i, arrays, joints.motion, rest, carried)
        rotation_columns(i, arrays, chosen.layout, joints.placed, slopes.spin, carried, own)
        if len(joints.feature) > 0:
            corrective_columns(i, arrays, chosen.layout, slopes.turning, blended, own)
        shape_columns(i, arrays, chosen.directions, slopes.shift, blended, own)


@njit(cache=True, parallel=True)
def linearise_vertices(chunks, arrays, chosen, coefficients, joints, slopes, jacobian):
    """All chosen vertices, on this thread if there is one chunk."""
    V = len(jacobian)
    if chunks == 1:
        linearise_range(0, V, arrays, chosen, coefficients, joints, slopes, jacobian)
    else:
        for c in prange(chunks):
            first, last = c * V // chunks, (c + 1) * V // chunks
            linearise_range(first, last, arrays, chosen, coefficients, joints, slopes, jacobian)
