"""Anatomical limits of the body's joints: usual clinical ranges, rounded outward, on our axes."""

from __future__ import annotations

import numpy as np

from .rig import JOINT_NAMES

# Degrees about x (to the left), y (up) and z (forward) for the middle and the left side, in the T-pose.
_LIMITS_DEG = {
    "hip": ((-130, 35), (-50, 50), (-35, 60)), "knee": ((-5, 150), (-15, 15), (-8, 8)),
    "ankle": ((-35, 55), (-30, 30), (-30, 25)), "foot": ((-60, 40), (-8, 8), (-8, 8)),
    "spine1": ((-20, 45), (-20, 20), (-20, 20)), "spine2": ((-15, 30), (-20, 20), (-15, 15)),
    "spine3": ((-15, 25), (-20, 20), (-15, 15)), "neck": ((-35, 35), (-40, 40), (-30, 30)),
    "head": ((-35, 35), (-45, 45), (-30, 30)), "collar": ((-15, 15), (-25, 25), (-15, 35)),
    "shoulder": ((-90, 90), (-130, 50), (-100, 95)), "elbow": ((-90, 90), (-155, 8), (-10, 10)),
    "wrist": ((-20, 20), (-40, 30), (-80, 85)), "jaw": ((-2, 32), (-8, 8), (-3, 3)),
    "eye_smplhf": ((-35, 35), (-45, 45), (-5, 5)),
}  # fmt: skip


def body_limits() -> np.ndarray:
    """(24, 3, 2) lower and upper limit of the axis-angle numbers of joints 1 to 24, radians."""
    limits = np.zeros((24, 3, 2))
    for j, name in enumerate(JOINT_NAMES[1:25]):
        side, _, rest = name.partition("_")
        ranges = np.array(_LIMITS_DEG[rest if side in ("left", "right") else name], dtype=float)
        limits[j] = ranges if side != "right" else _mirrored(ranges)
    return np.deg2rad(limits)


def _mirrored(ranges: np.ndarray) -> np.ndarray:
    """Turns about y and z change their sign."""
    return np.array([ranges[0], -ranges[1, ::-1], -ranges[2, ::-1]])
