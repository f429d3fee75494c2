"""Pose correctives before anything is learned: dual-quaternion skinning minus linear blending, per joint.

As for the hand; see ``open_hand/correctives.py``. Hands keep the open hand's own.
"""

from __future__ import annotations

import numpy as np
from open_hand.correctives import bent_difference
from scipy.spatial.transform import Rotation

from .limits import body_limits
from .rig import PARENTS, RIGHT_HAND, mirror_joints

_SAMPLES = 120
_VOLUMES = 16
_RIDGE = 0.05
_SMALLEST = 1e-4
_MATRIX_SIGNS = np.array([[1.0, -1, -1], [-1, 1, 1], [-1, 1, 1]])


def body_correctives(
    template: np.ndarray, joints: np.ndarray, weights: np.ndarray, faces: np.ndarray, mirror: np.ndarray,
    hand: np.ndarray, hand_vertices: np.ndarray, seed: int,
) -> np.ndarray:  # fmt: skip
    """(V, 3, 486) metres per rotation-matrix element; ``hand`` (V_hand, 3, 135) is the open hand's."""
    generator = np.random.default_rng(seed)
    limits, other = body_limits(), mirror_joints()
    directions = np.zeros((len(template), 3, 54, 9))
    for j in [j for j in range(1, 25) if j <= other[j]]:
        low, high = limits[j - 1].T
        rotations = Rotation.from_rotvec(generator.uniform(low, high, size=(_SAMPLES, 3)))
        share = weights[:, _descendants(j)].sum(1)
        mixed = np.flatnonzero((share > 1e-3) & (share < 1 - 1e-3))
        offsets = bent_difference(template[mixed], joints[j], share[mixed], rotations)
        offsets *= _share_that_keeps_volume(template, faces, joints[j], share, mixed, offsets, rotations)
        features = (rotations.as_matrix() - np.eye(3)).reshape(_SAMPLES, 9)
        gram = features.T @ features + _RIDGE * np.eye(9)
        solution = np.linalg.solve(gram, features.T @ offsets.reshape(_SAMPLES, -1))
        solution = solution.reshape(9, -1, 3)
        directions[mixed, :, j - 1] = np.where(np.abs(solution) < _SMALLEST, 0, solution).transpose(1, 2, 0)
    directions[hand_vertices, :, RIGHT_HAND[1] - 1 :] = hand.reshape(len(hand), 3, 15, 9)
    return _symmetric(directions, mirror, other).reshape(len(template), 3, 486)


def _share_that_keeps_volume(
    template: np.ndarray, faces: np.ndarray, joint: np.ndarray, share: np.ndarray, mixed: np.ndarray,
    offsets: np.ndarray, rotations: Rotation,
) -> float:  # fmt: skip
    """How much of the difference (0 to 1) leaves the body's volume nearest to that at rest.

    Blending matrices loses volume, blending screws about a wide joint (a hip) gains some: flesh does neither.
    """
    rest = _volume(template, faces)
    lost, gained = [], []
    for matrix, offset in list(zip(rotations.as_matrix(), offsets, strict=True))[:_VOLUMES]:
        blended = np.eye(3) + share[:, None, None] * (matrix - np.eye(3))
        corrected = template.copy()
        corrected[mixed] += offset
        plain, with_all = (np.einsum("vab,vb->va", blended, v - joint) for v in (template, corrected))
        lost.append(_volume(plain, faces) - rest)
        gained.append(_volume(with_all, faces) - _volume(plain, faces))
    best = -np.dot(lost, gained) / max(np.dot(gained, gained), 1e-15)
    return float(np.clip(best, 0.2, 1))


def _volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return float(np.einsum("fa,fa->", a, np.cross(b, c)) / 6)


def _symmetric(directions: np.ndarray, mirror: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Left joints from right ones or the other way, whichever was made; joints of the middle averaged."""
    signs = np.array([-1.0, 1, 1])[:, None, None, None] * _MATRIX_SIGNS[None]
    image = directions[mirror][:, :, other[1:] - 1].reshape(*directions.shape[:3], 3, 3)
    image = (image * signs.reshape(3, 1, 3, 3)).reshape(directions.shape)
    middle = (other[1:] == np.arange(1, 55))[None, None, :, None]
    return np.where(middle, (directions + image) / 2, directions + image)


def _descendants(j: int) -> list[int]:
    members = [j]
    for k in range(j + 1, 55):
        if PARENTS[k] in members:
            members.append(k)
    return members
