"""Recorded hand poses (Intel RealSense hand tracking samples, Apache-2.0) carried over to the hand's joints.

The recording's bones have z along the bone, positive x turns flex a finger, and equal frames of all bones
mean a flat hand; the map of its palm frame to ours is a quarter turn. Every bone's orientation is compared
with the one it has at our zero pose, so that natural spread and the thumb's rest are kept.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from .rig import FINGERS, PARENTS

_PALM = 1
_BONES = {
    "index": (5, 6, 7),
    "middle": (8, 9, 10),
    "ring": (11, 12, 13),
    "little": (14, 15, 16),
    "thumb": (2, 3, 4),
}
# Palm frame of the recording (x to the thumb, y out of the back, z to the fingers) in ours.
_A = np.array([[0.0, 0, -1], [0, 1, 0], [1, 0, 0]])


def read_poses(folder: Path) -> np.ndarray:
    """(N, 17, 7) position and quaternion (x, y, z, w) of every bone, metres."""
    rows = [np.loadtxt(folder / name, ndmin=2) for name in ("animbank.pose", "hand_data_example.pose")]
    return np.concatenate(rows).reshape(-1, 17, 7)


def carried_over(recorded: np.ndarray, joints: np.ndarray, tips: np.ndarray) -> np.ndarray:
    """(N, 45) axis-angle of joints 1..15, radians, for a hand with these joints (16, 3) and tips."""
    orientation = Rotation.from_quat(recorded[:, :, 3:].reshape(-1, 4)).as_matrix().reshape(-1, 17, 3, 3)
    palm = orientation[:, _PALM]
    turned = np.tile(np.eye(3), (len(recorded), 16, 1, 1))
    for f, finger in enumerate(FINGERS):
        chain = np.vstack([joints[3 * f + 1 : 3 * f + 4], tips[f]])
        for k, bone in enumerate(_BONES[finger]):
            now = _A @ np.swapaxes(palm, 1, 2) @ orientation[:, bone]
            # The source's tip bone of the thumb ends at the nail: the last bone is taken as straight at rest.
            start = min(k, 1) if finger == "thumb" else k
            turned[:, 3 * f + 1 + k] = now @ _zero_frame(finger, chain[start + 1] - chain[start], chain).T
    local = np.swapaxes(turned[:, PARENTS[1:]], 2, 3) @ turned[:, 1:]
    return Rotation.from_matrix(local.reshape(-1, 3, 3)).as_rotvec().reshape(len(recorded), 45)


def _zero_frame(finger: str, bone: np.ndarray, chain: np.ndarray) -> np.ndarray:
    """Frame of a bone at zero pose in the recording's manner: z along it, y (thumb: x) to the nail."""
    z = bone / np.linalg.norm(bone)
    if finger != "thumb":
        y = np.array([0.0, 1, 0])
        y -= (y @ z) * z
        y /= np.linalg.norm(y)
        return np.stack([np.cross(y, z), y, z], axis=1)
    x = thumb_nail(chain)
    x = x - (x @ z) * z
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1)


def thumb_nail(chain: np.ndarray) -> np.ndarray:
    """Where the thumb's nail looks at zero pose: away from the palm's middle, across the thumb."""
    along = chain[3] - chain[0]
    along = along / np.linalg.norm(along)
    # The pad looks at the little finger's side and a little down: measured on the template (see README).
    pad = np.array([-0.1, -0.55, -0.83])
    pad = pad - (pad @ along) * along
    return -pad / np.linalg.norm(pad)
