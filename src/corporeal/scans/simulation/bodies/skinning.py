"""Skinning with dual quaternions (Kavan et al. 2007): joints keep the volume that linear blending loses."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float
from scipy.spatial.transform import Rotation


def dual_quaternion_skinned(
    vertices: Float[np.ndarray, "V 3"],
    weights: sp.csr_matrix,
    parents: np.ndarray,
    rotations: Float[np.ndarray, "B 3 3"],
    translations: Float[np.ndarray, "B 3"],
) -> Float[np.ndarray, "V 3"]:
    """Vertices moved by blended screws.

    Args:
        vertices: at rest, metres.
        weights: (V, B), rows sum to one.
        parents: of the bones, -1 for the first, parents before children: of both quaternions of a turn each
            bone takes that which is nearer to its parent's.
        rotations: of the bones against rest.
        translations: a rest point x of a bone goes to ``R x + t``.
    """
    real = Rotation.from_matrix(rotations).as_quat()
    for bone, parent in enumerate(parents):
        if parent >= 0 and real[bone] @ real[parent] < 0:
            real[bone] = -real[bone]
    dual = 0.5 * _product(np.column_stack([translations, np.zeros(len(translations))]), real)
    blended = weights @ np.concatenate([real, dual], axis=1)
    length = np.linalg.norm(blended[:, :4], axis=1, keepdims=True)
    a, b = blended[:, :4] / length, blended[:, 4:] / length
    return Rotation.from_quat(a).apply(vertices) + 2 * _product(b, a * [-1, -1, -1, 1])[:, :3]


def _product(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Of quaternions (x, y, z, w)."""
    vector = p[:, 3:] * q[:, :3] + q[:, 3:] * p[:, :3] + np.cross(p[:, :3], q[:, :3])
    scalar = p[:, 3:] * q[:, 3:] - np.sum(p[:, :3] * q[:, :3], axis=1, keepdims=True)
    return np.concatenate([vector, scalar], axis=1)
