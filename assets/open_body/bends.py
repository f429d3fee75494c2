"""Which bends the soft person is put into: every joint over its range, alone and with its neighbours.

Correctives are local, so that one pose bends both arms, both legs and the spine at once, each as drawn for
itself.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.spatial import cKDTree

from corporeal.model.surface_model import SurfaceModel

from .rig import JOINT_NAMES, PARENTS
from .soft_person import bone_motions

# Degrees about x, y, z of the middle and the left side, in the T-pose; inside the limits of ``limits.py``,
# which are outer bounds. The first of the axes is the one that a joint is bent about alone.
_RANGES = {
    "hip": ("xyz", (-115, 25), (-40, 40), (-25, 50)), "knee": ("xyz", (0, 132), (-8, 8), (-4, 4)),
    "ankle": ("xyz", (-30, 45), (-15, 15), (-20, 15)), "foot": ("xyz", (-40, 25), (-4, 4), (-4, 4)),
    "spine1": ("xyz", (-12, 35), (-15, 15), (-16, 16)), "spine2": ("xyz", (-10, 25), (-15, 15), (-12, 12)),
    "spine3": ("xyz", (-8, 18), (-12, 12), (-10, 10)), "neck": ("xyz", (-25, 30), (-30, 30), (-22, 22)),
    "head": ("xyz", (-25, 25), (-35, 35), (-20, 20)), "collar": ("zyx", (-10, 10), (-20, 15), (-10, 30)),
    "shoulder": ("zyx", (-60, 60), (-110, 35), (-85, 85)), "elbow": ("yxz", (-70, 70), (-138, 4), (-6, 6)),
    "wrist": ("zyx", (-15, 15), (-35, 25), (-70, 75)),
}  # fmt: skip
# Bends of one joint that are only measured: joint, axis, degrees.
HELD_OUT_BENDS = (
    ("right_elbow", "y", 45), ("right_elbow", "y", 90), ("right_elbow", "y", 130),
    ("right_knee", "x", 45), ("right_knee", "x", 90), ("right_knee", "x", 125),
    ("right_hip", "x", -50), ("right_hip", "x", -105), ("right_hip", "z", -40),
    ("right_shoulder", "z", 40), ("right_shoulder", "z", 80), ("right_shoulder", "z", -45),
    ("right_shoulder", "z", -80), ("right_shoulder", "y", 90),
)  # fmt: skip
_MOVED, _ALONE = 0.7, 0.45
# Bones of forearm and hand keep this far from the skin of trunk, head and legs, metres.
_APART = 0.06
_FORE = ((18, 20, 28), (19, 21, 43))


def random_bends(model: SurfaceModel, count: int, seed: int) -> np.ndarray:
    """(count, 55, 3) axis-angle, radians; arms that would reach into the body are drawn again."""
    generator = np.random.default_rng(seed)
    joints = np.asarray(model.joint_regressor @ model.template)
    body = np.flatnonzero(model.skinning_weights[:, [0, 1, 2, 3, 4, 5, 6, 9, 12, 15]].sum(1) > 0.9)[::5]
    kept: list[np.ndarray] = []
    while len(kept) < count:
        pose = np.stack(
            [np.zeros(3), *(_drawn(name, generator) for name in JOINT_NAMES[1:22]), *np.zeros((33, 3))]
        )
        if _clear(model, joints, body, pose):
            kept.append(pose)
    return np.array(kept)


def single_bends() -> np.ndarray:
    """(n, 55, 3) of ``HELD_OUT_BENDS``."""
    poses = np.zeros((len(HELD_OUT_BENDS), 55, 3))
    for pose, (joint, axis, degrees) in zip(poses, HELD_OUT_BENDS, strict=True):
        pose[JOINT_NAMES.index(joint), "xyz".index(axis)] = np.deg2rad(degrees)
    return poses


def _drawn(name: str, generator: np.random.Generator) -> np.ndarray:
    side, _, rest = name.partition("_")
    order, *ranges = _RANGES[rest if side in ("left", "right") else name]
    low, high = np.array(ranges, dtype=float).T
    turn = generator.uniform(low, high)
    # Ranges about one axis say little of two at once: the corners of the box are left out.
    turn /= max(1.0, float(np.linalg.norm(turn / np.where(turn < 0, low - 1e-9, high + 1e-9))))
    if generator.random() < _ALONE:
        turn *= np.eye(3)["xyz".index(order[0])]
    turn *= generator.random() < _MOVED
    return np.deg2rad(turn * ([1, -1, -1] if side == "right" else [1, 1, 1]))


def _clear(model: SurfaceModel, joints: np.ndarray, body: np.ndarray, pose: np.ndarray) -> bool:
    motions = bone_motions(joints, PARENTS, pose)
    blended = np.einsum("vk,kab->vab", model.skinning_weights[body], motions[:, :3])
    skin = np.einsum("vab,vb->va", blended[:, :, :3], model.template[body]) + blended[:, :, 3]
    placed = np.einsum("kab,kb->ka", motions[:, :3, :3], joints) + motions[:, :3, 3]
    near = cKDTree(skin)
    chains = [placed[list(chain)] for chain in _FORE]
    rods = [a + t * (b - a) for chain in chains for a, b in pairwise(chain) for t in (0.25, 0.6, 1)]
    tips = [2 * chain[2] - chain[1] for chain in chains]
    return float(near.query(np.array(rods + tips))[0].min()) > _APART
