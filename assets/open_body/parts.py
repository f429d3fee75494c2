"""Parts of the body: every vertex belongs to the part of the joint that moves it most."""

from __future__ import annotations

import numpy as np

from .rig import JOINT_NAMES

_MIDDLE = {
    "pelvis": ("pelvis",),
    "torso": ("spine1", "spine2", "spine3"),
    "neck": ("neck",),
    "head": ("head", "jaw"),
}
_SIDED = {
    "shoulder": ("collar",), "upper_arm": ("shoulder",), "forearm": ("elbow",), "thigh": ("hip",),
    "calf": ("knee",), "foot": ("ankle", "foot"), "eye": ("eye_smplhf",),
}  # fmt: skip


def body_parts(weights: np.ndarray, mirror: np.ndarray) -> dict[str, np.ndarray]:
    """Names as field names them, "left_hand" with all its fingers; together they are all vertices."""
    strongest = weights.argmax(1)
    # On the middle line left and right are equal: what is of neither side decides.
    middle = np.flatnonzero(mirror == np.arange(len(mirror)))
    neither = [j for j, name in enumerate(JOINT_NAMES) if not name.startswith(("left_", "right_"))]
    strongest[middle] = np.array(neither)[weights[middle][:, neither].argmax(1)]
    groups = {name: list(joints) for name, joints in _MIDDLE.items()}
    for side in ("left", "right"):
        for name, joints in _SIDED.items():
            groups[f"{side}_{name}"] = [f"{side}_{joint}" for joint in joints]
        fingers = JOINT_NAMES[25:40] if side == "left" else JOINT_NAMES[40:]
        groups[f"{side}_hand"] = [f"{side}_wrist", *fingers]
    return {
        name: np.flatnonzero(np.isin(strongest, [JOINT_NAMES.index(joint) for joint in joints]))
        for name, joints in groups.items()
    }
