"""The poses of a session: joints explored one by one, the grasps of Feix et al. 2009, and natural poses.

Angles are of our own making. Rows of a pose: forearm, hand, then index, middle, little, ring, thumb with
three bones each; columns: flexion towards the palm, spread towards the thumb, twist; in degrees against the
flat hand.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float

from corporeal.scans.simulation.files import recorded_angles

# First rows of the fingers.
INDEX, MIDDLE, LITTLE, RING, THUMB = 2, 5, 8, 11, 14
_FINGERS = {"i": INDEX, "m": MIDDLE, "r": RING, "l": LITTLE}
Bend = tuple[float | int, float | int, float | int]
_STRAIGHT: Bend = (0, 0, 0)
_FIST: Bend = (66, 84, 36)
# Flexion, spread and twist of the thumb's first bone, then flexion of the other two.
Thumb = tuple[float | int, float | int, float | int, float | int, float | int]
_THUMB_REST: Thumb = (8, 0, 0, 5, 5)
_THUMB_OVER: Thumb = (28, -14, 4, 32, 42)
_LIMITS_LOW = np.array([-25.0, -32, -50])
_LIMITS_HIGH = np.array([108.0, 32, 50])
_MOST_CURLED = 205.0
# How much two performances of one pose differ: degrees shared by the hand, by a finger, and of each joint.
_SHARED, _FINGER, _JOINT = 3.0, 4.0, 2.5


@dataclass(frozen=True, eq=False)
class HandPose:
    """A named pose: group ("explore", "grasp" or "natural") and angles (17, 3) in degrees."""

    name: str
    group: str
    angles: Float[np.ndarray, "17 3"]


def _pose(
    fingers: Mapping[str, Bend] | None = None,
    thumb: Thumb = _THUMB_REST,
    spread: Mapping[str, float | int] | None = None,
    wrist: tuple[float | int, float | int] = (0, 0),
    rest: Bend = _STRAIGHT,
) -> Float[np.ndarray, "17 3"]:
    """Angles from the bends of fingers (several letters share one), their spread, thumb and wrist."""
    angles = np.zeros((17, 3))
    for row in _FINGERS.values():
        angles[row : row + 3, 0] = rest
    for letters, bend in (fingers or {}).items():
        for letter in letters:
            angles[_FINGERS[letter] : _FINGERS[letter] + 3, 0] = bend
    for letters, degrees in (spread or {}).items():
        for letter in letters:
            angles[_FINGERS[letter], 1] = degrees
    angles[THUMB], angles[THUMB + 1 : THUMB + 3, 0] = thumb[:3], thumb[3:]
    angles[1, :2] = wrist
    return angles


def _exploration() -> dict[str, Float[np.ndarray, "17 3"]]:
    wide = {"i": 12, "m": 2, "r": -8, "l": -18}
    return {
        "flat": _pose(),
        "relaxed": _pose(
            {"i": (18, 24, 12), "m": (24, 28, 14), "r": (28, 30, 16), "l": (28, 28, 16)}, (14, 2, 4, 10, 12)
        ),
        "spread-wide": _pose(spread=wide, thumb=(-12, 14, 0, -5, -8)),
        "closed-flat": _pose(spread={"i": -5, "r": 4, "l": 9}, thumb=(0, -26, 0, 0, 0)),
        "fist": _pose(rest=_FIST, thumb=_THUMB_OVER),
        "hook": _pose(rest=(8, 85, 50), thumb=(5, 0, 0, 10, 10)),
        "knuckles-only": _pose(rest=(68, 4, 2), thumb=(12, -4, 0, 5, 5)),
        "index-bent": _pose({"i": (55, 75, 40)}),
        "middle-bent": _pose({"m": (55, 70, 40), "r": (12, 14, 6)}),
        "ring-bent": _pose({"r": (52, 65, 38), "l": (22, 24, 10), "m": (12, 12, 5)}),
        "little-bent": _pose({"l": (55, 65, 40), "r": (18, 20, 8)}),
        "index-points": _pose({"mrl": _FIST}, (28, -12, 6, 30, 40)),
        "two-fingers": _pose({"rl": _FIST}, (28, -12, 6, 30, 40), spread={"i": 8, "m": -6}),
        "horns": _pose({"mr": _FIST}, (28, -12, 6, 30, 40), spread={"i": 4, "l": -8}),
        "thumb-in": _pose(thumb=(44, 2, 14, 30, 45)),
        "thumb-up": _pose(rest=(72, 88, 42), thumb=(-16, 6, 0, -6, -14)),
        "oppose-index": _pose({"i": (46, 46, 24), "mrl": (22, 24, 12)}, (31, 12, 16, 14, 22)),
        "oppose-middle": _pose(
            {"m": (54, 52, 26), "i": (30, 24, 12), "rl": (30, 28, 14)}, (37, 11, 20, 18, 24)
        ),
        "oppose-little": _pose(
            {"l": (58, 52, 26), "r": (46, 38, 20), "im": (26, 22, 12)}, (50, 10, 26, 22, 28)
        ),
        "wrist-bent": _pose({"imrl": (20, 24, 12)}, (12, 2, 4, 8, 10), wrist=(38, 0)),
    }


def _grasps() -> dict[str, Float[np.ndarray, "17 3"]]:
    wrapped = {"i": (44, 52, 28), "m": (48, 56, 30), "r": (52, 58, 32), "l": (54, 56, 32)}
    ball = {"i": 8, "m": 2, "r": -5, "l": -12}
    curled = (70, 80, 45)
    return {
        "large-diameter": _pose(
            {"i": (30, 38, 22), "m": (34, 42, 24), "r": (36, 44, 24), "l": (34, 42, 22)},
            (28, 16, 14, 10, 16),
            ball,
        ),
        "small-diameter": _pose(
            {"i": (56, 70, 38), "m": (60, 74, 40), "r": (64, 76, 42), "l": (66, 72, 40)}, (38, 10, 16, 22, 30)
        ),
        "medium-wrap": _pose(wrapped, (34, 12, 14, 16, 22)),
        "adducted-thumb": _pose({"imrl": (58, 74, 40)}, (4, -18, 0, 6, 6)),
        "light-tool": _pose({"imrl": (66, 86, 46)}, (22, -8, 8, 18, 20)),
        "prismatic-four": _pose(
            {"i": (40, 34, 14), "m": (44, 34, 14), "r": (46, 34, 14), "l": (46, 32, 14)}, (34, 12, 18, 10, 14)
        ),
        "prismatic-three": _pose(
            {"i": (42, 34, 14), "m": (46, 34, 14), "r": (48, 34, 14), "l": (24, 28, 14)}, (35, 12, 18, 10, 14)
        ),
        "prismatic-two": _pose(
            {"i": (44, 36, 14), "m": (48, 36, 14), "r": (22, 26, 14), "l": (20, 26, 14)}, (35, 12, 17, 10, 15)
        ),
        "palmar-pinch": _pose({"i": (48, 40, 16), "mrl": (16, 18, 9)}, (32, 12, 15, 10, 14)),
        "power-disk": _pose(
            {"imrl": (14, 58, 38)}, (10, 20, 4, 10, 30), {"i": 14, "m": 3, "r": -8, "l": -18}
        ),
        "power-sphere": _pose(
            {"i": (26, 46, 30), "m": (28, 48, 30), "r": (28, 48, 30), "l": (26, 46, 28)},
            (26, 18, 12, 12, 24),
            {"i": 13, "m": 3, "r": -8, "l": -18},
        ),
        "precision-disk": _pose(
            {"imrl": (20, 44, 28)}, (12, 20, 6, 6, 18), {"i": 15, "m": 4, "r": -8, "l": -18}
        ),
        "precision-sphere": _pose(
            {"imrl": (42, 26, 12)}, (30, 16, 14, 4, 10), {"i": 12, "m": 3, "r": -7, "l": -16}
        ),
        "tripod": _pose({"i": (44, 42, 20), "m": (50, 42, 20), "rl": (40, 48, 26)}, (34, 12, 18, 12, 18)),
        "fixed-hook": _pose({"imrl": (26, 84, 44)}, (6, -6, 0, 8, 10)),
        "lateral": _pose({"i": (44, 66, 34), "mrl": (56, 70, 38)}, (14, -10, 4, 10, 14)),
        "index-extension": _pose({"i": (18, 12, 6), "mrl": (62, 76, 42)}, (30, 8, 14, 16, 24)),
        "extension-type": _pose({"imrl": (46, 16, 6)}, (26, 8, 12, 6, 8)),
        "distal-type": _pose({"i": (30, 62, 34), "mrl": (40, 66, 36)}, (24, 16, 10, 18, 34)),
        "writing-tripod": _pose(
            {"i": (42, 46, 14), "m": (50, 54, 26), "rl": (58, 62, 34)}, (32, 6, 16, 14, 24), wrist=(-16, 0)
        ),
        "tripod-variation": _pose(
            {"i": (34, 58, 34), "m": (56, 62, 32), "rl": (62, 72, 38)}, (36, 6, 18, 20, 26), wrist=(-8, 0)
        ),
        "parallel-extension": _pose({"imrl": (56, 8, 4)}, (28, 6, 14, 4, 4)),
        "adduction-grip": _pose(
            {"i": (14, 12, 6), "m": (18, 14, 6), "rl": (34, 36, 18)}, spread={"i": -3, "m": 3}
        ),
        "tip-pinch": _pose({"i": (42, 58, 40), "mrl": (30, 34, 18)}, (31, 12, 15, 18, 40)),
        "lateral-tripod": _pose(
            {"i": (38, 52, 26), "m": (46, 60, 30), "rl": (56, 64, 36)}, (20, -6, 8, 14, 26)
        ),
        "sphere-four-finger": _pose(
            {"imr": (36, 46, 26), "l": (18, 26, 14)},
            (30, 16, 16, 10, 20),
            {"i": 10, "m": 2, "r": -7, "l": -14},
        ),
        "quadpod": _pose(
            {"i": (40, 42, 20), "m": (44, 42, 20), "r": (46, 42, 20), "l": (30, 34, 18)}, (34, 13, 18, 10, 16)
        ),
        "sphere-three-finger": _pose(
            {"im": (34, 44, 26), "rl": (56, 66, 36)}, (30, 16, 16, 10, 20), {"i": 10, "m": -3}
        ),
        "stick": _pose({"i": (34, 56, 26), "mrl": (50, 66, 36)}, (12, -8, 4, 6, 8)),
        "palmar": _pose({"imrl": curled}, (16, 0, 6, 10, 12), wrist=(10, 8)),
        "ventral": _pose({"i": (30, 40, 20), "mrl": (60, 78, 42)}, (24, 2, 10, 12, 20), wrist=(0, -14)),
    }


@lru_cache(maxsize=1)
def protocol_poses() -> tuple[HandPose, ...]:
    """The 51 poses: 20 that explore the joints, then 31 grasps; names begin with their number."""
    named = [(name, "explore", angles) for name, angles in _exploration().items()]
    named += [(name, "grasp", angles) for name, angles in _grasps().items()]
    for _, _, angles in named:
        angles.setflags(write=False)
    return tuple(
        HandPose(f"p{number:02d}-{name}", group, angles)
        for number, (name, group, angles) in enumerate(named, start=1)
    )


def performed(pose: HandPose, generator: np.random.Generator) -> HandPose:
    """One performance of a pose: nobody holds it twice alike."""
    angles = pose.angles.copy()
    common = _SHARED * generator.normal()
    for row in (*_FINGERS.values(), THUMB):
        own = common + _FINGER * generator.normal()
        flexion = own * np.array([1.0, 0.9, 0.6]) + _JOINT * generator.normal(size=3)
        angles[row : row + 3, 0] += flexion * (0.6 if row == THUMB else 1.0)
        angles[row, 1] += 1.5 * generator.normal()
        angles[row : row + 3, 2] += 1.0 * generator.normal(size=3)
    angles[1, :2] += (5.0, 3.0) * generator.normal(size=2)
    return HandPose(pose.name, pose.group, _within_limits(angles))


def natural_pose(generator: np.random.Generator) -> HandPose:
    """A pose between two recorded ones that are alike, with the wrist turned at will."""
    recorded = recorded_angles()
    first = recorded[generator.integers(len(recorded))]
    distance = np.abs(recorded - first).mean((1, 2))
    near = recorded[np.argsort(distance)[generator.integers(1, 6)]]
    angles = np.zeros((17, 3))
    share = generator.random()
    angles[2:] = (1 - share) * first + share * near
    angles[1, :2] = (12.0, 6.0) * generator.normal(size=2)
    return HandPose("natural", "natural", _within_limits(angles))


def subset_for(count: int, generator: np.random.Generator) -> tuple[int, ...]:
    """The poses that one hand of one person does: the flat one and five eighths of the others, in order."""
    kept = max(1, round(0.63 * count))
    others = generator.permutation(np.arange(1, count))[: kept - 1]
    return (0, *np.sort(others).tolist())


def _within_limits(angles: np.ndarray) -> Float[np.ndarray, "17 3"]:
    limited = np.clip(angles, _LIMITS_LOW, _LIMITS_HIGH)
    # A wrist has its own limits.
    limited[1] = np.clip(angles[1], (-45, -20, -10), (60, 25, 10))
    limited[0] = 0
    for row in _FINGERS.values():
        # Beyond this sum a fingertip would have to sink into the palm.
        total = limited[row : row + 3, 0].sum()
        limited[row : row + 3, 0] *= min(1.0, _MOST_CURLED / max(total, 1.0))
    return limited
