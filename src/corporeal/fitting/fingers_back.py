"""Fingers that were found after a while, followed back to when they were lost.

While little is seen of a hand, a tracker holds wrong fingers as well as right ones. Once more is seen they
are found elsewhere at once; a recorded sequence can then be gone through from there to its beginning, until
the scan, where it shows enough of the hand, says that fingers were where they had been tracked. Where it
shows little in every frame, all of them together tell whether what was found is right at all.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from corporeal.fitting.arms import HARDLY_SEEN
from corporeal.fitting.finger_search import Comparison
from corporeal.fitting.frame_data import frame_points
from corporeal.fitting.frame_fit import FrameFitter, FrameStart, scan_surface
from corporeal.fitting.gaps import NOT_SEEN, SeenPose
from corporeal.fitting.pose_terms import is_hand
from corporeal.scans.scan import Scan

# Radians to the next frame: recorded fingers turn by 6 degrees, found ones by more than this.
_LEAP = np.deg2rad(15.0)
# Within so many frames after it was found, a hand is taken where most of it is seen.
_SETTLED = 30
# Radians: nearer to what was tracked, fingers are the same.
_SAME = np.deg2rad(5.0)


@dataclass(frozen=True, eq=False)
class TrackedSequence:
    """What was tracked, and how to look again.

    Attributes:
        frames: poses and what was seen, in their order.
        translations: (N, 3) metres.
        scan_of: reads the scan of a frame's number; None where there is none.
    """

    frames: Sequence[SeenPose]
    translations: Float[np.ndarray, "N 3"]
    scan_of: Callable[[int], Scan | None]


@dataclass(frozen=True, eq=False)
class _FoundHand:
    """A hand's block, its joints, the frame where its fingers were found, and where most of it is seen."""

    name: str
    joints: Int[np.ndarray, " J"]
    found: int
    best: int


def fingers_back(
    fitter: FrameFitter, sequence: TrackedSequence, on_frame: Callable[[int], None] | None = None
) -> dict[int, Float[np.ndarray, "K 3"]]:
    """The poses of the frames in which fingers belong elsewhere than they were tracked, by their numbers.

    From where fingers turn by more than 15 degrees within a frame, their hand is followed back: each frame is
    solved for with the fingers of the one after it, and they stay as they are found unless the scan shows
    enough of the hand to say that the tracked ones explain it much better. That, fingers as they were
    tracked, or a frame that failed ends it. Where the hand is out of sight they go on unchanged. In the end
    all stay as they were tracked if those explain the frames better in the (geometric) mean, and the fingers
    before the leap are followed forth instead, by the same rules: ones that were wrongly found in the last
    frames of a hand on a thigh had gone back by 60 frames, none of which spoke loudly enough alone.

    Args:
        fitter: of the subject's model.
        sequence: what was tracked.
        on_frame: told the number of every frame that is looked at.
    """
    frames = sequence.frames
    if not frames or not fitter.options.find_fingers:
        return {}
    tracked = np.array([frame.pose for frame in frames])
    poses = tracked.copy()
    tell = on_frame or (lambda number: None)
    for block in fitter.model.pose_blocks:
        if not is_hand(block):
            continue
        joints = np.array(block.joints)
        for found in _leaps(tracked[:, joints])[::-1].tolist():
            if not len(_leaps(poses[found - 1 : found + 1, joints])):
                continue  # gone back over already
            hand = _FoundHand(block.name, joints, found, _best_seen(frames, block.name, found))
            if not _followed(fitter, sequence, poses, hand, range(hand.best - 1, -1, -1), tell):
                _followed(fitter, sequence, poses, hand, range(found, len(frames)), tell)
    changed = np.flatnonzero((poses != tracked).any(axis=(1, 2)))
    return {int(number): poses[number] for number in changed}


def _leaps(turns: Float[np.ndarray, "N J 3"]) -> Int[np.ndarray, " n"]:
    """Frames in which a joint stands elsewhere than in the one before."""
    return np.flatnonzero(_apart(turns[:-1], turns[1:]) > _LEAP) + 1


def _apart(ones: Float[np.ndarray, "N J 3"], others: Float[np.ndarray, "N J 3"]) -> Float[np.ndarray, " N"]:
    """The largest angle between joints, radians."""
    between = Rotation.from_rotvec(ones.reshape(-1, 3)).inv() * Rotation.from_rotvec(others.reshape(-1, 3))
    return between.magnitude().reshape(ones.shape[:-1]).max(axis=-1)


def _best_seen(frames: Sequence[SeenPose], hand: str, found: int) -> int:
    """The frame after a hand was found that shows most of it, before it is out of sight again."""
    best, most = found, 0.0
    for number in range(found, min(found + _SETTLED, len(frames))):
        share = _seen(frames[number], hand)
        if share <= NOT_SEEN:
            break
        best, most = (number, share) if share > most else (best, most)
    return best


def _seen(frame: SeenPose, hand: str) -> float:
    return frame.signals[f"{hand}_seen"] if frame.tracked else 0.0


def _followed(
    fitter: FrameFitter, sequence: TrackedSequence, poses: Float[np.ndarray, "N K 3"], hand: _FoundHand,
    numbers: range, on_frame: Callable[[int], None],
) -> bool:  # fmt: skip
    """Lay the fingers of the frame before ``numbers`` along these, in place; False where the scans refuse."""
    joints, laid = hand.joints, {}
    fingers, for_tracked = poses[numbers.start - numbers.step, joints], 0.0
    for number in numbers:
        # From where most is seen to where they were found, fingers are only laid anew.
        anew = numbers.step < 0 and number >= hand.found
        frame = sequence.frames[number]
        if not frame.tracked:
            break
        if _seen(frame, hand.name) > HARDLY_SEEN:
            on_frame(number)
            again = _again(fitter, sequence, poses[number], number, hand, fingers)
            for_tracked += 0.0 if again is None else again[1].for_ones
            if again is None or again[1].clear:
                if not anew:
                    break
                fingers = poses[number, joints]
            else:
                fingers = again[0]
            if not anew and _apart(fingers[None], frame.pose[None, joints])[0] < _SAME:
                break
        laid[number] = fingers
    if for_tracked > 0:
        return False
    for number, turns in laid.items():
        poses[number, joints] = turns
    return True


def _again(
    fitter: FrameFitter, sequence: TrackedSequence, tracked: Float[np.ndarray, "K 3"], number: int,
    hand: _FoundHand, fingers: Float[np.ndarray, "J 3"],
) -> tuple[Float[np.ndarray, "J 3"], Comparison] | None:  # fmt: skip
    """A frame's fingers, solved for from those of its neighbour, and how what was tracked compares."""
    scan = sequence.scan_of(number)
    if scan is None:
        return None
    points, back = frame_points(scan, fitter.options), scan_surface(scan)
    pose = tracked.copy()
    pose[hand.joints] = fingers
    vector, begin = (np.concatenate([sequence.translations[number], one.ravel()]) for one in (tracked, pose))
    found = fitter.fingers_again(points, vector, FrameStart(begin, pose, back=back), hand.name)
    return None if found is None else (fitter.fields.parameters(found[0]).pose[hand.joints], found[1])
