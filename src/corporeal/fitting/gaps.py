"""Arms and fingers that were lost for a while: once they are found again, their poses before are mended.

While an arm is missing a tracker can but hold it against what it hangs on, and of fingers that it finds in
another pose it does not know since when they had it. Of a sequence more is known: where the arm was and where
it came back, and that no finger gets anywhere at once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation, Slerp

from corporeal.fitting.arms import HARDLY_SEEN
from corporeal.fitting.frame_data import forearm_of, joints_above
from corporeal.fitting.gap_regression import SeenMotion
from corporeal.fitting.pose_terms import is_hand
from corporeal.model.statistics import PoseBlock
from corporeal.model.surface_model import SurfaceModel

# A hand of which no more than this share is confirmed at least once was missing.
NOT_SEEN = 0.02
# And a forearm: over eight sequences thighs confirmed up to 0.06 of one that was missing, and of one
# that was there at least 0.58 was confirmed.
_FOREARM_NOT_SEEN = 0.1
# Frames: over a longer time a straight way means nothing.
_LONGEST = 60
# Degrees per second: no finger turns faster. The recorded ones that simulated people move reach 350.
_FASTEST = 900.0


@dataclass(frozen=True, eq=False)
class SeenPose:
    """What of a tracked frame tells of gaps.

    Attributes:
        pose: (K, 3) as it was tracked, axis-angle in radians.
        signals: of the frame: "left_hand_seen", "left_forearm_seen" and so on are shares that the scan
            confirms.
        tracked: whether the frame did not fail; one that did keeps its pose.
    """

    pose: Float[np.ndarray, "K 3"]
    signals: Mapping[str, float]
    tracked: bool


@dataclass(frozen=True, eq=False)
class BridgedPose:
    """The pose of a frame after bridging.

    Attributes:
        pose: (K, 3) axis-angle, radians.
        hands: that lie in a gap, such as "left_hand".
        led: hands with fingers on their way to where they are found later.
    """

    pose: Float[np.ndarray, "K 3"]
    hands: tuple[str, ...]
    led: tuple[str, ...]


def bridged(model: SurfaceModel, frames: Sequence[SeenPose], fps: float) -> list[BridgedPose]:
    """The poses of a sequence, those of arms that were out of sight laid between those before and after.

    Of a hand alone, wrist and fingers; where the forearm is missing too, the elbow and the turn of the upper
    arm about itself. Fingers go the shortest way at a steady rate; the others as they went with the rest of
    the body, and with time, while they were seen. An arm that never comes back, or not within
    60 frames, stays as it was tracked. Fingers that turn faster than 900 degrees per second set out earlier.
    All else stays.

    Args:
        model: what was tracked; gaps are bridged of bodies alone.
        frames: in their order.
        fps: frames per second.
    """
    poses = np.array([frame.pose for frame in frames])
    hands: list[list[str]] = [[] for _ in frames]
    for block in model.pose_blocks:
        if is_hand(block) and frames:
            for first, after in _bridge_arm(model, block, frames, poses, fps):
                for names in hands[first:after]:
                    names.append(block.name)
    for number, frame in enumerate(frames):
        if not frame.tracked:
            poses[number], hands[number] = frame.pose, []
    led = {
        block.name: _led(poses, list(block.joints), np.deg2rad(_FASTEST) / fps)
        for block in model.pose_blocks
        if is_hand(block)
    }
    return [
        BridgedPose(pose, tuple(names), tuple(hand for hand, when in led.items() if when[number]))
        for number, (pose, names) in enumerate(zip(poses, hands, strict=True))
    ]


def gaps_of_hand(frames: Sequence[SeenPose], hand: str) -> list[tuple[int, int]]:
    """First frame of every gap in which a hand, say "left_hand", was out of sight, and the first after it.

    A gap that is open at an end of the sequence, or longer than 60 frames, is none.
    """
    return _gaps(_shares(frames, hand), NOT_SEEN)


def _shares(frames: Sequence[SeenPose], part: str) -> Float[np.ndarray, " N"]:
    """A frame that failed tells nothing: it neither begins a gap nor ends one."""
    return np.array([frame.signals[f"{part}_seen"] if frame.tracked else HARDLY_SEEN for frame in frames])


def _gaps(seen: Float[np.ndarray, " N"], nothing: float) -> list[tuple[int, int]]:
    """First frame of every gap and the first after it; what is open at an end, or too long, is none.

    In a gap at least once no more than ``nothing`` is seen.
    """
    gaps, first = [], None
    for number, share in enumerate(seen):
        if share <= HARDLY_SEEN:
            first = number if first is None else first
            continue
        if first and number - first <= _LONGEST and seen[first:number].min() <= nothing:
            gaps.append((first, number))
        first = None
    return gaps


def _bridge_arm(
    model: SurfaceModel, block: PoseBlock, frames: Sequence[SeenPose], poses: Float[np.ndarray, "N K 3"],
    fps: float,
) -> list[tuple[int, int]]:  # fmt: skip
    """Lay one arm through its gaps, in place; gives those of its hand. A hand without an arm has none."""
    above = joints_above(model, block)
    if len(above) < 3:
        return []
    wrist, elbow, shoulder = above[:3]
    hand = _shares(frames, block.name)
    forearm = np.maximum(hand, _shares(frames, forearm_of(block.name)))
    of_hand, of_forearm = gaps_of_hand(frames, block.name), _gaps(forearm, _FOREARM_NOT_SEEN)
    if not of_hand and not of_forearm:
        return []
    bone = _bone(model, shoulder, elbow)
    rest = _rest_of_pose(model, poses, shoulder, bone)
    if of_forearm:
        motion = SeenMotion.of_angles(rest, forearm > HARDLY_SEEN, fps)
        turns = poses[:, shoulder].copy()
        twists = _twists(turns, bone)
        for first, after in of_forearm:
            poses[first:after, elbow] = motion.turns_told(poses[:, elbow], first, after)
            # The upper arm itself is seen, but not how it is turned about itself.
            change = motion.told(twists[:, None], first, after)[:, 0] - twists[first:after]
            twisted = Rotation.from_rotvec(turns[first:after]) * Rotation.from_rotvec(change[:, None] * bone)
            poses[first:after, shoulder] = twisted.as_rotvec()
    # The twist has left where the upper arm points to as it was.
    motion = SeenMotion.of_angles(np.hstack([rest, _from_mean(poses[:, elbow])]), hand > HARDLY_SEEN, fps)
    for first, after in of_hand:
        poses[first:after, wrist] = motion.turns_told(poses[:, wrist], first, after)
        _bridge(poses, first, after, block.joints)
    return of_hand


def _rest_of_pose(
    model: SurfaceModel, poses: Float[np.ndarray, "N K 3"], shoulder: int, bone: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "N a"]:
    """What an arm swings with, radians: where its upper arm points to, its collar bone, trunk and legs."""
    hands = [block for block in model.pose_blocks if is_hand(block)]
    arms = {joint for hand in hands for joint in joints_above(model, hand)[:4]}
    body = {joint for block in model.pose_blocks if block.name == "body" for joint in block.joints}
    collar = int(model.parents[shoulder])
    angles = [Rotation.from_rotvec(poses[:, shoulder]).apply(bone), _from_mean(poses[:, collar])]
    # Of the trunk and the legs half, or all of them together would outweigh the arm's own.
    angles += [0.5 * _from_mean(poses[:, joint]) for joint in sorted(body - arms - {0})]
    return np.hstack(angles)


def _from_mean(turns: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 3"]:
    rotations = Rotation.from_rotvec(turns)
    return (rotations.mean().inv() * rotations).as_rotvec()


def _twists(turns: Float[np.ndarray, "N 3"], bone: Float[np.ndarray, "3"]) -> Float[np.ndarray, " N"]:
    """How far a limb is turned about itself, radians, without leaps."""
    quaternions = Rotation.from_rotvec(turns).as_quat()
    return np.unwrap(2 * np.arctan2(quaternions[:, :3] @ bone, quaternions[:, 3]))


def _bridge(poses: Float[np.ndarray, "N K 3"], first: int, after: int, joints: Sequence[int]) -> None:
    """Lay joints the shortest way between the frames around a gap, in place."""
    for joint in joints:
        ends = Rotation.from_rotvec(poses[[first - 1, after], joint])
        poses[first:after, joint] = Slerp([first - 1, after], ends)(np.arange(first, after)).as_rotvec()


def _led(poses: Float[np.ndarray, "N K 3"], joints: Sequence[int], most: float) -> Bool[np.ndarray, " N"]:
    """Let joints set out so early that none turns by more than ``most`` to the next frame, in place."""
    changed = np.zeros(len(poses), dtype=bool)
    for number in range(len(poses) - 2, -1, -1):
        after = Rotation.from_rotvec(poses[number + 1, joints])
        back = (after.inv() * Rotation.from_rotvec(poses[number, joints])).as_rotvec()
        angles = np.linalg.norm(back, axis=1)
        fast = np.flatnonzero(angles > most)
        if len(fast):
            shortened = back[fast] * (most / angles[fast, None])
            poses[number, np.array(joints)[fast]] = (
                after[fast] * Rotation.from_rotvec(shortened)
            ).as_rotvec()
            changed[number] = True
    return changed


def _bone(model: SurfaceModel, joint: int, child: int) -> Float[np.ndarray, "3"]:
    """Direction of a bone at the zero pose."""
    rest = model.joint_regressor @ model.template
    return (rest[child] - rest[joint]) / np.linalg.norm(rest[child] - rest[joint])
