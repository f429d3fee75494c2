"""How the simulator's 104 bones follow the 55 joints of a pose: whole turns, shares of turns or of a twist.

The MakeHuman rig has two bones in every upper arm, forearm and thigh, five in the spine, three in the neck
and one between collar bone and upper arm: they share turns that a fitted body gives to one joint. The
skinning is therefore not the fitted body's, where the skin turns and where it twists.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

PARENTS = np.array(
    [-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 15, 15, 15]
    + [wrist if k % 3 == 0 else first + k - 1 for wrist, first in ((20, 25), (21, 40)) for k in range(15)]
)
"""Parents of the 55 joints, in SMPL-X's order."""

_ALONG_ARM, _ALONG_LEG = np.array([1.0, 0, 0]), np.array([0.0, 1, 0])
# The makers' numbers of fingers, in the order of a model hand: index, middle, little, ring, thumb.
_FINGERS = (2, 3, 5, 4, 1)


class Following(NamedTuple):
    """A bone turns with a joint, and by a share of what another joint turns against its parent.

    ``part`` says what the share is of: the whole turn, or its twist about the limb's axis in the T-pose.
    """

    joint: int
    other: int = 0
    share: float = 0.0
    part: Literal["turn", "arm twist", "leg twist"] = "turn"


@lru_cache(maxsize=1)
def followings() -> dict[str, Following]:
    """What every bone follows, by the bone's name in the source."""
    found = {
        "root": Following(0),
        "spine05": Following(0, 3, 0.5),
        "spine04": Following(3),
        "spine03": Following(3, 6, 0.6),
        "spine02": Following(6, 9, 0.3),
        "spine01": Following(9),
        "neck01": Following(9, 12, 0.5),
        "neck02": Following(12),
        "neck03": Following(12, 15, 0.5),
        "head": Following(15),
        "eye.L": Following(15),
        "eye.R": Following(15),
    }
    for right, side in enumerate("LR"):
        hip, knee, ankle, foot, collar, shoulder, elbow, wrist = (
            joint + right for joint in (1, 4, 7, 10, 13, 16, 18, 20)
        )
        own = {
            "pelvis": Following(0),
            "upperleg01": Following(hip, hip, -0.5, "leg twist"),
            "upperleg02": Following(hip),
            "lowerleg01": Following(knee),
            "lowerleg02": Following(knee),
            "foot": Following(ankle),
            "clavicle": Following(collar),
            "shoulder01": Following(collar, shoulder, 0.3),
            "upperarm01": Following(shoulder, shoulder, -0.5, "arm twist"),
            "upperarm02": Following(shoulder),
            "lowerarm01": Following(elbow, elbow, -0.6, "arm twist"),
            "lowerarm02": Following(elbow, wrist, 0.5, "arm twist"),
            "wrist": Following(wrist),
        }
        own |= {f"metacarpal{k}": Following(wrist) for k in range(1, 5)}
        own |= {f"toe{toe}-{k}": Following(foot) for toe in range(1, 6) for k in range(1, 4)}
        for place, finger in enumerate(_FINGERS):
            first = (25, 40)[right] + 3 * place
            own |= {f"finger{finger}-{k + 1}": Following(first + k) for k in range(3)}
        found |= {f"{bone}.{side}": following for bone, following in own.items()}
    return found


def bone_rotations(pose: Float[np.ndarray, "55 3"], bones: tuple[str, ...]) -> Float[np.ndarray, "B 3 3"]:
    """Rotation of every bone in the world, against the T-pose.

    Args:
        pose: axis-angle of every joint against its parent, radians, the root first.
        bones: names of the bones.
    """
    own = Rotation.from_rotvec(pose)
    local, world = own.as_matrix(), np.empty((55, 3, 3))
    for joint, parent in enumerate(PARENTS):
        world[joint] = local[joint] if parent < 0 else world[parent] @ local[joint]
    follows = [followings()[bone] for bone in bones]
    extra = np.zeros((len(bones), 3))
    for number, following in enumerate(follows):
        if following.share:
            extra[number] = following.share * _part(own[following.other], following.part)
    joints = np.array([following.joint for following in follows])
    return world[joints] @ Rotation.from_rotvec(extra).as_matrix()


def _part(turn: Rotation, part: str) -> np.ndarray:
    if part == "turn":
        return turn.as_rotvec()
    axis = _ALONG_ARM if part == "arm twist" else _ALONG_LEG
    x, y, z, w = turn.as_quat()
    angle = 2 * np.arctan2(np.array([x, y, z]) @ axis, w)
    return ((angle + np.pi) % (2 * np.pi) - np.pi) * axis


def bone_places(
    heads: Float[np.ndarray, "B 3"],
    parents: np.ndarray,
    rotations: Float[np.ndarray, "B 3 3"],
) -> Float[np.ndarray, "B 3"]:
    """Where the bones' heads come to lie when the first one's stays: chained down the tree.

    Args:
        heads: at rest, metres.
        parents: of the bones, -1 for the first, parents before children.
        rotations: of the bones against rest.
    """
    places = heads.copy()
    for bone, parent in enumerate(parents):
        if parent >= 0:
            places[bone] = places[parent] + rotations[parent] @ (heads[bone] - heads[parent])
    return places
