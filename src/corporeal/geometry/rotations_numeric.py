"""Rotations as numpy arrays: exponential, logarithm and left Jacobian, for solvers and exporters.

Angles in radians, column vectors, quaternions as (w, x, y, z): the conventions of ``rotations`` (torch), to
which the tests hold these functions.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

# Below this squared angle the series are exact to the last bit in float64.
_SMALL_SQUARED_ANGLE = 1e-3


def skew(vectors: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 3 3"]:
    """Matrices of the cross product: ``skew(a) @ b == cross(a, b)``."""
    matrices = np.zeros((len(vectors), 3, 3), dtype=vectors.dtype)
    x, y, z = vectors.T
    matrices[:, 0, 1], matrices[:, 0, 2], matrices[:, 1, 2] = -z, y, -x
    matrices[:, 1, 0], matrices[:, 2, 0], matrices[:, 2, 1] = z, -y, x
    return matrices


def matrix_from_axis_angle(axis_angle: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 3 3"]:
    """The exponential: Rodrigues' formula, exact at zero."""
    squared = np.einsum("ij,ij->i", axis_angle, axis_angle)
    sinc, cosc, _ = _coefficients(squared)
    cross = skew(axis_angle)
    outer = axis_angle[:, :, None] * axis_angle[:, None, :]
    cosine = (1 - cosc * squared)[:, None, None]
    return cosine * np.eye(3) + sinc[:, None, None] * cross + cosc[:, None, None] * outer


def left_jacobian(axis_angle: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 3 3"]:
    """J with exp(w + d) = exp(J d) exp(w) to first order: from steps in axis-angle to turns in the world.

    J = I + (1 - cos a) / a^2 [w] + (a - sin a) / a^3 [w]^2 with a = |w|. Singular at a = 2 pi.
    """
    squared = np.einsum("ij,ij->i", axis_angle, axis_angle)
    _, cosc, sincc = _coefficients(squared)
    cross = skew(axis_angle)
    return np.eye(3) + cosc[:, None, None] * cross + sincc[:, None, None] * (cross @ cross)


def axis_angle_from_matrix(matrices: Float[np.ndarray, "N 3 3"]) -> Float[np.ndarray, "N 3"]:
    """The logarithm, with angles in [0, pi]."""
    return axis_angle_from_quaternion(quaternion_from_matrix(matrices))


def quaternion_from_axis_angle(axis_angle: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 4"]:
    """Unit quaternions (w, x, y, z); w is negative for angles beyond pi: the way is kept."""
    half = 0.5 * np.linalg.norm(axis_angle, axis=1, keepdims=True)
    return np.concatenate([np.cos(half), 0.5 * np.sinc(half / np.pi) * axis_angle], axis=1)


def quaternion_from_matrix(matrices: Float[np.ndarray, "N 3 3"]) -> Float[np.ndarray, "N 4"]:
    """Unit quaternions (w, x, y, z) with w >= 0.

    They are read off the largest column of the matrix q q^T, whose elements are linear in the rotation: no
    division is by less than 1/2 (Shepperd 1978).
    """
    m = matrices
    trace = np.einsum("nii->n", m)
    products = np.empty((len(m), 4, 4), dtype=m.dtype)
    products[:, 0, 0] = 1 + trace
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        products[:, 0, i + 1] = products[:, i + 1, 0] = m[:, k, j] - m[:, j, k]
        products[:, i + 1, i + 1] = 1 + 2 * m[:, i, i] - trace
        products[:, i + 1, j + 1] = products[:, j + 1, i + 1] = m[:, i, j] + m[:, j, i]
    best = np.einsum("nii->ni", products).argmax(axis=1)
    chosen = products[np.arange(len(m)), best]
    unit = chosen / np.linalg.norm(chosen, axis=1, keepdims=True)
    return np.where(unit[:, :1] < 0, -unit, unit)


def axis_angle_from_quaternion(quaternions: Float[np.ndarray, "N 4"]) -> Float[np.ndarray, "N 3"]:
    """Axis-angle with angles in [0, pi] of quaternions (w, x, y, z) of any length but zero."""
    signed = np.where(quaternions[:, :1] < 0, -quaternions, quaternions)
    w, vectors = signed[:, 0], signed[:, 1:]
    sine = np.linalg.norm(vectors, axis=1)
    # The quotient loses no digits for small sines; only 0 / 0 must not arise, and its limit is 2 / w.
    tiny = sine < np.sqrt(np.finfo(quaternions.dtype).tiny)
    factor = 2 * np.arctan2(sine, w) / np.where(tiny, 1, sine)
    return np.where(tiny, 2 / np.where(tiny, w, 1), factor)[:, None] * vectors


def _coefficients(squared: Float[np.ndarray, " N"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """sin(a)/a, (1-cos a)/a^2 and (a-sin a)/a^3 as functions of a^2."""
    small = squared < _SMALL_SQUARED_ANGLE
    s = np.where(small, squared, 0)
    safe = np.where(small, 1, squared)
    a = np.sqrt(safe)
    half = np.sin(0.5 * a)
    sinc = np.where(small, 1 - s / 6 * (1 - s / 20 * (1 - s / 42 * (1 - s / 72))), np.sin(a) / a)
    cosc = np.where(small, 0.5 - s / 24 * (1 - s / 30 * (1 - s / 56 * (1 - s / 90))), 2 * half * half / safe)
    sincc_series = (1 - s / 20 * (1 - s / 42 * (1 - s / 72))) / 6
    return sinc, cosc, np.where(small, sincc_series, (a - np.sin(a)) / (safe * a))
