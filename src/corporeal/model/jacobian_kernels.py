"""Kernels of the closed-form evaluation and Jacobian of one posed surface, in float64."""

import math

import numpy as np
from numba import njit, prange

# Taylor series below this squared angle are exact to the last bit.
SMALL_SQUARED_ANGLE = 1e-3


@njit(cache=True)
def rotation_and_left_jacobian(vector, rotation, left):
    """R(vector), and J with R(vector + d) ~ exp(J d) R(vector); smooth at every angle."""
    x, y, z = vector[0], vector[1], vector[2]
    squared = x * x + y * y + z * z
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
def joint_motion(pose, rest_joints, parents, local, left, turned, placed, offset):
    """Chain rotations down the tree: ``turned`` G, ``placed`` p and ``offset`` = p - G j of every joint."""
    for k in range(len(parents)):
        rotation_and_left_jacobian(pose[k], local[k], left[k])
        p = parents[k]
        for a in range(3):
            if p < 0:
                placed[k, a] = rest_joints[k, a]
                for b in range(3):
                    turned[k, a, b] = local[k, a, b]
            else:
                placed[k, a] = placed[p, a]
                for b in range(3):
                    placed[k, a] += turned[p, a, b] * (rest_joints[k, b] - rest_joints[p, b])
                    turned[k, a, b] = (
                        turned[p, a, 0] * local[k, 0, b]
                        + turned[p, a, 1] * local[k, 1, b]
                        + turned[p, a, 2] * local[k, 2, b]
                    )
        for a in range(3):
            offset[k, a] = placed[k, a]
            for b in range(3):
                offset[k, a] -= turned[k, a, b] * rest_joints[k, b]


@njit(cache=True)
def rest_joint_positions(joint_template, joint_directions, coefficients, ranges, rest_joints):
    """Joints of the shaped body at the zero pose."""
    for k in range(len(joint_template)):
        for a in range(3):
            total = joint_template[k, a]
            for r in range(len(ranges)):
                for s in range(ranges[r, 0], ranges[r, 0] + ranges[r, 1]):
                    total += joint_directions[k, a, s] * coefficients[s]
            rest_joints[k, a] = total


@njit(cache=True)
def pose_feature(local, feature):
    """Rotation matrices of the joints after the root minus the identity, row-major."""
    for k in range(1, len(local)):
        for a in range(3):
            for b in range(3):
                feature[9 * (k - 1) + 3 * a + b] = local[k, a, b] - (1.0 if a == b else 0.0)


@njit(cache=True, fastmath=True)
def rest_coordinate(i, a, template, directions, coefficients, ranges, pose_directions, feature,
                    corrected_starts, corrected_joints):  # fmt: skip
    """One coordinate of one vertex before skinning; an empty feature leaves the correctives out."""
    total = template[i, a]
    for r in range(len(ranges)):
        for s in range(ranges[r, 0], ranges[r, 0] + ranges[r, 1]):
            total += directions[i, a, s] * coefficients[s]
    P = len(feature)
    if P > 0:
        first, last = corrected_starts[i], corrected_starts[i + 1]
        if 9 * (last - first) == P:
            for e in range(P):
                total += pose_directions[i, a, e] * feature[e]
        else:
            for n in range(first, last):
                start = 9 * (corrected_joints[n] - 1)
                for e in range(start, start + 9):
                    total += pose_directions[i, a, e] * feature[e]
    return total


@njit(cache=True, parallel=True, fastmath=True)
def pose_vertices(chunks, template, directions, coefficients, ranges, pose_directions, feature,
                  corrected_starts, corrected_joints, weight_starts, weight_joints, weight_values,
                  turned, offset, translation, vertices):  # fmt: skip
    """Blend shapes and linear blend skinning of all vertices."""
    V = len(template)
    for chunk in prange(chunks):
        for i in range(chunk * V // chunks, (chunk + 1) * V // chunks):
            x = rest_coordinate(i, 0, template, directions, coefficients, ranges, pose_directions, feature,
                                corrected_starts, corrected_joints)  # fmt: skip
            y = rest_coordinate(i, 1, template, directions, coefficients, ranges, pose_directions, feature,
                                corrected_starts, corrected_joints)  # fmt: skip
            z = rest_coordinate(i, 2, template, directions, coefficients, ranges, pose_directions, feature,
                                corrected_starts, corrected_joints)  # fmt: skip
            for a in range(3):
                total = translation[a]
                for n in range(weight_starts[i], weight_starts[i + 1]):
                    k = weight_joints[n]
                    total += weight_values[n] * (
                        turned[k, a, 0] * x + turned[k, a, 1] * y + turned[k, a, 2] * z + offset[k, a]
                    )
                vertices[i, a] = total


@njit(cache=True, fastmath=True)
def joint_derivatives(parents, local, left, turned, placed, joint_directions, ranges, spin, turning, shift,
                      joint_jacobian):  # fmt: skip
    """Everything of the Jacobian that depends on joints alone.

    ``spin`` (K, 3, 3) maps a change of a joint's axis-angle to the world rotation of its subtree, ``turning``
    (K, 9, 3) is the derivative of the rotation matrix, ``shift`` (K, 3, n) that of ``offset`` by coefficients.
    """
    K = len(parents)
    for k in range(K):
        p = parents[k]
        for a in range(3):
            for b in range(3):
                if p < 0:
                    spin[k, a, b] = left[k, a, b]
                else:
                    spin[k, a, b] = (
                        turned[p, a, 0] * left[k, 0, b]
                        + turned[p, a, 1] * left[k, 1, b]
                        + turned[p, a, 2] * left[k, 2, b]
                    )
                u, v, w = left[k, 0, b], left[k, 1, b], left[k, 2, b]
                turning[k, a, b] = v * local[k, 2, a] - w * local[k, 1, a]
                turning[k, 3 + a, b] = w * local[k, 0, a] - u * local[k, 2, a]
                turning[k, 6 + a, b] = u * local[k, 1, a] - v * local[k, 0, a]
            joint_jacobian[k, a, a] = 1.0
        m = p
        while m >= 0:
            x, y, z = placed[k, 0] - placed[m, 0], placed[k, 1] - placed[m, 1], placed[k, 2] - placed[m, 2]
            for b in range(3):
                u, v, w = spin[m, 0, b], spin[m, 1, b], spin[m, 2, b]
                joint_jacobian[k, 0, 3 + 3 * m + b] = v * z - w * y
                joint_jacobian[k, 1, 3 + 3 * m + b] = w * x - u * z
                joint_jacobian[k, 2, 3 + 3 * m + b] = u * y - v * x
            m = parents[m]
        joint_shape_columns(k, p, turned, joint_directions, ranges, shift, joint_jacobian)


@njit(cache=True)
def joint_shape_columns(k, p, turned, joint_directions, ranges, shift, joint_jacobian):
    """Derivative of joint ``k`` and of its offset by shape and expression; parents come first."""
    out = 3 + 3 * len(turned)
    column = 0
    for r in range(len(ranges)):
        for s in range(ranges[r, 0], ranges[r, 0] + ranges[r, 1]):
            for a in range(3):
                moved = joint_directions[k, a, s]
                carried = 0.0
                for b in range(3):
                    carried += turned[k, a, b] * joint_directions[k, b, s]
                if p >= 0:
                    moved = joint_jacobian[p, a, out + column]
                    for b in range(3):
                        moved += turned[p, a, b] * (joint_directions[k, b, s] - joint_directions[p, b, s])
                joint_jacobian[k, a, out + column] = moved
                shift[k, a, column] = moved - carried
            column += 1


@njit(cache=True, fastmath=True)
def blend(i, weight_starts, weight_joints, weight_values, turned, offset, rest, carried, blended):
    """Per-joint parts of one skinned vertex into ``carried`` (K, 4); the blended rotation into ``blended``."""
    x, y, z = rest[0], rest[1], rest[2]
    blended[:] = 0.0
    for n in range(weight_starts[i], weight_starts[i + 1]):
        k = weight_joints[n]
        w = weight_values[n]
        for a in range(3):
            carried[k, a] += w * (
                turned[k, a, 0] * x + turned[k, a, 1] * y + turned[k, a, 2] * z + offset[k, a]
            )
            for b in range(3):
                blended[a, b] += w * turned[k, a, b]
        carried[k, 3] += w


@njit(cache=True, fastmath=True)
def rotation_columns(i, chain_starts, chain_joints, parents, placed, spin, carried, jacobian):
    """Derivative by every joint's rotation: cross product with what its descendants carry of the vertex."""
    for n in range(chain_starts[i + 1] - 1, chain_starts[i] - 1, -1):
        m = chain_joints[n]
        weight = carried[m, 3]
        x = carried[m, 0] - weight * placed[m, 0]
        y = carried[m, 1] - weight * placed[m, 1]
        z = carried[m, 2] - weight * placed[m, 2]
        column = 3 + 3 * m
        for b in range(3):
            u, v, w = spin[m, 0, b], spin[m, 1, b], spin[m, 2, b]
            jacobian[i, 0, column + b] = v * z - w * y
            jacobian[i, 1, column + b] = w * x - u * z
            jacobian[i, 2, column + b] = u * y - v * x
        p = parents[m]
        for a in range(4):
            if p >= 0:
                carried[p, a] += carried[m, a]
            carried[m, a] = 0.0


@njit(cache=True, fastmath=True)
def corrective_columns(i, corrected_starts, corrected_joints, pose_directions, turning, blended, jacobian):
    """The pose correctives' own derivative, added to the columns of their joints."""
    for n in range(corrected_starts[i], corrected_starts[i + 1]):
        m = corrected_joints[n]
        first = 9 * (m - 1)
        column = 3 + 3 * m
        for b in range(3):
            x, y, z = 0.0, 0.0, 0.0
            for e in range(9):
                x += pose_directions[i, 0, first + e] * turning[m, e, b]
                y += pose_directions[i, 1, first + e] * turning[m, e, b]
                z += pose_directions[i, 2, first + e] * turning[m, e, b]
            for a in range(3):
                jacobian[i, a, column + b] += blended[a, 0] * x + blended[a, 1] * y + blended[a, 2] * z


@njit(cache=True, fastmath=True)
def shape_columns(i, weight_starts, weight_joints, weight_values, directions, ranges, shift, blended,
                  jacobian):  # fmt: skip
    """Derivative by shape and expression: directions turned, plus what they move the joints by."""
    out = jacobian.shape[2] - shift.shape[2]
    for a in range(3):
        column = 0
        for r in range(len(ranges)):
            first = ranges[r, 0]
            for s in range(ranges[r, 1]):
                jacobian[i, a, out + column + s] = (
                    blended[a, 0] * directions[i, 0, first + s]
                    + blended[a, 1] * directions[i, 1, first + s]
                    + blended[a, 2] * directions[i, 2, first + s]
                )
            column += ranges[r, 1]
        for n in range(weight_starts[i], weight_starts[i + 1]):
            k = weight_joints[n]
            w = weight_values[n]
            for s in range(column):
                jacobian[i, a, out + s] += w * shift[k, a, s]


@njit(cache=True, parallel=True, fastmath=True)
def vertex_derivatives(chunks, template, directions, coefficients, ranges, pose_directions, feature,
                       corrected_starts, corrected_joints, weight_starts, weight_joints, weight_values,
                       chain_starts, chain_joints, parents, turned, placed, offset, spin, turning, shift,
                       translation, vertices, jacobian):  # fmt: skip
    """Posed vertices and their Jacobian, one pass over the vertices."""
    V = len(template)
    K = len(parents)
    for chunk in prange(chunks):
        carried = np.zeros((K, 4))
        rest = np.empty(3)
        blended = np.empty((3, 3))
        for i in range(chunk * V // chunks, (chunk + 1) * V // chunks):
            for a in range(3):
                rest[a] = rest_coordinate(i, a, template, directions, coefficients, ranges, pose_directions,
                                          feature, corrected_starts, corrected_joints)  # fmt: skip
                for q in range(3 + 3 * K):
                    jacobian[i, a, q] = 0.0
                jacobian[i, a, a] = 1.0
            blend(i, weight_starts, weight_joints, weight_values, turned, offset, rest, carried, blended)
            rotation_columns(i, chain_starts, chain_joints, parents, placed, spin, carried, jacobian)
            if len(feature) > 0:
                corrective_columns(i, corrected_starts, corrected_joints, pose_directions, turning, blended,
                                   jacobian)  # fmt: skip
            shape_columns(i, weight_starts, weight_joints, weight_values, directions, ranges, shift, blended,
                          jacobian)  # fmt: skip
            for a in range(3):
                vertices[i, a] = translation[a]
                for n in range(weight_starts[i], weight_starts[i + 1]):
                    k = weight_joints[n]
                    vertices[i, a] += weight_values[n] * (
                        turned[k, a, 0] * rest[0] + turned[k, a, 1] * rest[1] + turned[k, a, 2] * rest[2]
                        + offset[k, a]
                    )  # fmt: skip
