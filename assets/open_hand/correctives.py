"""Pose correctives before anything is learned: what dual-quaternion skinning does better than blending.

Linear blending loses volume at bent joints; blending screws (Kavan et al. 2007) does not. Joint by joint, the
difference over sampled rotations is brought back to the rest pose and fitted by the joint's nine
rotation-matrix elements, so that correctives are local to one joint by construction.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from .rig import PARENTS

_SAMPLES = 80
_RIDGE = 0.05
_SMALLEST = 2e-5


def dual_quaternion_correctives(
    template: np.ndarray, joints: np.ndarray, weights: np.ndarray, poses: np.ndarray, seed: int
) -> np.ndarray:
    """(V, 3, 135) offsets per rotation-matrix element minus the identity, metres."""
    generator = np.random.default_rng(seed)
    directions = np.zeros((len(template), 3, 135))
    for j in range(1, 16):
        recorded = poses[generator.integers(0, len(poses), _SAMPLES), 3 * (j - 1) : 3 * j]
        rotations = Rotation.from_rotvec(recorded + 0.1 * generator.normal(size=recorded.shape))
        descendants = _descendants(j)
        share = weights[:, descendants].sum(1)
        mixed = np.flatnonzero((share > 1e-3) & (share < 1 - 1e-3))
        offsets = bent_difference(template[mixed], joints[j], share[mixed], rotations)
        features = (rotations.as_matrix() - np.eye(3)).reshape(_SAMPLES, 9)
        gram = features.T @ features + _RIDGE * np.eye(9)
        solution = np.linalg.solve(gram, features.T @ offsets.reshape(_SAMPLES, -1))
        solution = solution.reshape(9, -1, 3)
        solution[np.abs(solution) < _SMALLEST] = 0
        directions[mixed, :, 9 * (j - 1) : 9 * j] = solution.transpose(1, 2, 0)
    return directions


def bent_difference(
    points: np.ndarray, joint: np.ndarray, share: np.ndarray, rotations: Rotation
) -> np.ndarray:
    """Rest-pose offsets (N, v, 3) that make linear blending give the blended screw's surface.

    Turning one joint about its own centre, the blended screw is the turn by a share of the angle: the centre
    does not move, so that the dual part vanishes.
    """
    local = points - joint
    matrices = rotations.as_matrix()
    blended = np.eye(3) + share[None, :, None, None] * (matrices - np.eye(3))[:, None]
    quaternions = rotations.as_quat()
    quaternions = quaternions * np.sign(quaternions[:, 3:] + 1e-12)
    mixed = share[None, :, None] * quaternions[:, None] + (1 - share[None, :, None]) * np.array(
        [0.0, 0, 0, 1]
    )
    turned = Rotation.from_quat(mixed.reshape(-1, 4)).as_matrix().reshape(*mixed.shape[:2], 3, 3)
    wanted = np.einsum("nvab,vb->nva", turned, local)
    return np.linalg.solve(blended, wanted[..., None])[..., 0] - local


def _descendants(j: int) -> list[int]:
    members = [j]
    for k in range(j + 1, 16):
        if PARENTS[k] in members:
            members.append(k)
    return members
