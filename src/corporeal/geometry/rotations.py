"""Rotations as torch tensors: every map is exact and differentiable at 0 and at pi.

Angles in radians, column vectors, quaternions as (w, x, y, z). All functions take any number of leading
dimensions and keep dtype and device.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

# Below this squared angle the Taylor series is exact to the last bit in float64 (error ~ angle^8 / 9!).
_SMALL_SQUARED_ANGLE = 1e-3


def _sinc_and_cosc(squared: Float[Tensor, " *b"]) -> tuple[Float[Tensor, " *b"], Float[Tensor, " *b"]]:
    """sin(a)/a and (1-cos(a))/a^2 as functions of a^2, smooth at zero.

    Both branches are evaluated on safe inputs, because ``where`` lets NaN gradients of the branch that is not
    taken through.
    """
    small = squared < _SMALL_SQUARED_ANGLE
    safe = torch.where(small, torch.ones_like(squared), squared)
    angle = safe.sqrt()
    series = torch.where(small, squared, torch.zeros_like(squared))
    sinc_series = 1 - series / 6 * (1 - series / 20 * (1 - series / 42 * (1 - series / 72)))
    cosc_series = 0.5 - series / 24 * (1 - series / 30 * (1 - series / 56 * (1 - series / 90)))
    half = torch.sin(0.5 * angle)
    sinc = torch.where(small, sinc_series, torch.sin(angle) / angle)
    # 2 sin^2(a/2) keeps the digits that 1 - cos(a) loses for small angles.
    cosc = torch.where(small, cosc_series, 2 * half * half / safe)
    return sinc, cosc


def skew(vector: Float[Tensor, "*b 3"]) -> Float[Tensor, "*b 3 3"]:
    """The matrix of the cross product: ``skew(a) @ b == cross(a, b)``."""
    x, y, z = vector.unbind(-1)
    zero = torch.zeros_like(x)
    return torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], dim=-1).reshape(*vector.shape[:-1], 3, 3)


def matrix_from_axis_angle(axis_angle: Float[Tensor, "*b 3"]) -> Float[Tensor, "*b 3 3"]:
    """Rodrigues' formula, with no epsilon inside: exact at zero, where smplx adds 1e-8."""
    squared = (axis_angle * axis_angle).sum(-1)
    sinc, cosc = _sinc_and_cosc(squared)
    cross = skew(axis_angle)
    outer = axis_angle[..., :, None] * axis_angle[..., None, :]
    identity = torch.eye(3, dtype=axis_angle.dtype, device=axis_angle.device)
    cosine = 1 - cosc * squared
    return cosine[..., None, None] * identity + sinc[..., None, None] * cross + cosc[..., None, None] * outer


def matrix_from_quaternion(quaternion: Float[Tensor, "*b 4"]) -> Float[Tensor, "*b 3 3"]:
    """Rotation of a quaternion (w, x, y, z) of any length but zero."""
    w, x, y, z = quaternion.unbind(-1)
    scale = 2.0 / (quaternion * quaternion).sum(-1)
    rows = [
        1 - scale * (y * y + z * z), scale * (x * y - w * z), scale * (x * z + w * y),
        scale * (x * y + w * z), 1 - scale * (x * x + z * z), scale * (y * z - w * x),
        scale * (x * z - w * y), scale * (y * z + w * x), 1 - scale * (x * x + y * y),
    ]  # fmt: skip
    return torch.stack(rows, dim=-1).reshape(*quaternion.shape[:-1], 3, 3)


def matrix_from_6d(six: Float[Tensor, "*b 6"]) -> Float[Tensor, "*b 3 3"]:
    """Gram-Schmidt on two columns: six numbers are the first two columns, one after the other.

    Zhou et al. 2019, "On the Continuity of Rotation Representations in Neural Networks", equation 15.
    """
    first, second = six[..., :3], six[..., 3:]
    x = first / first.norm(dim=-1, keepdim=True)
    y = second - (x * second).sum(-1, keepdim=True) * x
    y = y / y.norm(dim=-1, keepdim=True)
    return torch.stack([x, y, torch.linalg.cross(x, y)], dim=-1)


def sixd_from_matrix(matrix: Float[Tensor, "*b 3 3"]) -> Float[Tensor, "*b 6"]:
    """The first two columns, one after the other: the inverse of ``matrix_from_6d``."""
    return matrix[..., :2].transpose(-1, -2).reshape(*matrix.shape[:-2], 6)


def quaternion_from_matrix(matrix: Float[Tensor, "*b 3 3"]) -> Float[Tensor, "*b 4"]:
    """Unit quaternion (w, x, y, z) with w >= 0; at a half turn the sign is that of the largest axis element.

    Of the four equivalent formulas the one with the largest pivot is taken (Shepperd 1978), so that no
    division is by less than 1/2 and the gradient is finite everywhere.
    """
    m = matrix
    trace = m[..., 0, 0] + m[..., 1, 1] + m[..., 2, 2]
    pivots = torch.stack([trace, m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]], dim=-1)
    best = pivots.argmax(dim=-1)
    w = torch.stack([1 + trace, m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0],
                     m[..., 1, 0] - m[..., 0, 1]], dim=-1)  # fmt: skip
    x = torch.stack([m[..., 2, 1] - m[..., 1, 2], 1 + 2 * m[..., 0, 0] - trace, m[..., 0, 1] + m[..., 1, 0],
                     m[..., 0, 2] + m[..., 2, 0]], dim=-1)  # fmt: skip
    y = torch.stack([m[..., 0, 2] - m[..., 2, 0], m[..., 0, 1] + m[..., 1, 0], 1 + 2 * m[..., 1, 1] - trace,
                     m[..., 1, 2] + m[..., 2, 1]], dim=-1)  # fmt: skip
    z = torch.stack([m[..., 1, 0] - m[..., 0, 1], m[..., 0, 2] + m[..., 2, 0], m[..., 1, 2] + m[..., 2, 1],
                     1 + 2 * m[..., 2, 2] - trace], dim=-1)  # fmt: skip
    candidates = torch.stack([w, x, y, z], dim=-2)
    chosen = torch.take_along_dim(candidates, best[..., None, None], dim=-2).squeeze(-2)
    unit = chosen / chosen.norm(dim=-1, keepdim=True)
    return torch.where(unit[..., :1] < 0, -unit, unit)


def axis_angle_from_quaternion(quaternion: Float[Tensor, "*b 4"]) -> Float[Tensor, "*b 3"]:
    """Axis-angle with angle in [0, pi] of a quaternion (w, x, y, z) of any length but zero."""
    unit = quaternion / quaternion.norm(dim=-1, keepdim=True)
    unit = torch.where(unit[..., :1] < 0, -unit, unit)
    w, vector = unit[..., 0], unit[..., 1:]
    squared = (vector * vector).sum(-1)
    small = squared < _SMALL_SQUARED_ANGLE
    safe = torch.where(small, torch.ones_like(squared), squared)
    sine = safe.sqrt()
    series = torch.where(small, squared, torch.zeros_like(squared))
    # angle / sin(angle/2) = 2 asin(s) / s with s^2 = series, for w >= 0
    asin_series = 2 * (1 + series * (1 / 6 + series * (3 / 40 + series * (15 / 336 + series * 105 / 3456))))
    asin_series = asin_series + 2 * series**5 * (945 / 42240 + series * 10395 / 599040)
    factor = torch.where(small, asin_series, 2 * torch.atan2(sine, w) / sine)
    return factor[..., None] * vector


def axis_angle_from_matrix(matrix: Float[Tensor, "*b 3 3"]) -> Float[Tensor, "*b 3"]:
    """Axis-angle with angle in [0, pi]; finite gradients at 0 and at pi."""
    return axis_angle_from_quaternion(quaternion_from_matrix(matrix))
