"""Axes of the bones and the angles of the rest pose, both against the zero pose of the open hand.

The rest pose is that of the body which both meshes are made of. How far its fingers are from the open hand's
straight ones is read off the open hand's own joints, regressed from its template where that lies on the skin
at rest: other joints in the same flesh would give a pose that nobody took. The thumb's zero pose is its rest.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from open_hand.recorded_poses import thumb_nail

_FLAT = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
_BACK = np.array([0.0, 1, 0])
_THUMB = 4


def axes_at_rest(
    open_joints: np.ndarray, rest_joints: np.ndarray, rest_tips: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Axes (17, 3, 3) at rest, rows flexion, spread, bone; angles (17, 3) of the rest pose in degrees.

    Args:
        open_joints: (16, 3) of the open hand at zero pose.
        rest_joints: (16, 3) of the open hand where its template lies on the simulator's skin at rest.
        rest_tips: (5, 3) ends of its fingers at rest.
    """
    axes, angles = np.tile(_FLAT, (17, 1, 1)), np.zeros((17, 3))
    for finger in range(5):
        joints = slice(3 * finger + 1, 3 * finger + 4)
        chain = np.vstack([rest_joints[joints], rest_tips[finger]])
        bones = _unit(np.diff(chain, axis=0))
        flat = _unit(open_joints[3 * finger + 3] - open_joints[3 * finger + 1])
        turned = np.eye(3)
        for k, bone in enumerate(bones):
            thumb = finger == _THUMB
            zero = _frame(bone, thumb_nail(chain)) if thumb else _frame(flat, _BACK)
            following = np.eye(3) if thumb else _shortest_turn(flat, bone)
            local = zero @ turned.T @ following @ zero.T
            flexion, spread, twist = Rotation.from_matrix(local).as_euler("XYZ", degrees=True)
            turned = following
            axes[2 + 3 * finger + k] = zero @ turned.T
            angles[2 + 3 * finger + k] = flexion, spread, twist
    return axes, angles


def _frame(bone: np.ndarray, back: np.ndarray) -> np.ndarray:
    """Rows: the axis that bends the bone away from its back, the back, the bone."""
    flexion = _unit(np.cross(back, bone))
    return np.stack([flexion, np.cross(bone, flexion), bone])


def _shortest_turn(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    axis = np.cross(a, b)
    angle = np.arctan2(np.linalg.norm(axis), a @ b)
    return Rotation.from_rotvec(_unit(axis) * angle).as_matrix()


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
