"""Fingers that were found after a while, followed back to when they were lost.

While little is seen of a hand, a tracker holds wrong fingers as well as right ones. Once more is seen they
are found elsewhere at once; a recorded sequence can then be gone through from there to its beginning, until
the scan, where it shows enough of the hand, says that fingers were where they had been tracked. Where it
shows little in every frame, all of them together tell whether what was found is right at all.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from corporeal.fitting.arms import HARDLY_SEEN, SETTLING
from corporeal.fitting.finger_search import Comparison
from corporeal.fitting.frame_data import frame_points
from corporeal.fitting.frame_fit import FrameFitter, FrameStart, scan_surface
from corporeal.fitting.gaps import NOT_SEEN, SeenPose, gaps_of_hand
from corporeal.fitting.pose_terms import is_hand
from corporeal.scans.scan import Scan

# Radians to the next frame: recorded fingers turn by 6 degrees, found ones by more than this.
_LEAP = np.deg2rad(15.0)
# Within so many frames after it was found, a hand is taken where most of it is seen.
_SOON = 30
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
    """A hand's block, its joints, the frame where its fingers were found, and which way it is then followed.

    From ``best``, where most of it is seen: where fingers leapt, back from there; where the hand was out of
    sight, back from its return, since nothing says that they were wrong in between.
    """

    name: str
    joints: Int[np.ndarray, " J"]
    found: int
    best: int
    leapt: bool

    @property
    def back(self) -> range:
        """The frames that fingers go back over."""
        return range((self.best if self.leapt else self.found) - 1, -1, -1)


def fingers_back(
    fitter: FrameFitter, sequence: TrackedSequence, on_frame: Callable[[int], None] | None = None
) -> dict[int, Float[np.ndarray, "K 3"]]:
    """The poses of the frames in which fingers belong elsewhere than they were tracked, by their numbers.

    From where fingers turn by more than 15 degrees within a frame, their hand is followed back, and so it is
    over every gap in which it was out of sight: each frame is solved for with the fingers of the one after
    it, and they stay as they are found unless the scan shows enough of the hand to say that the tracked ones
    explain it much better. That, fingers as they were tracked, or a frame that failed ends it. Where the
    hand is out of sight they go on unchanged. In the end all stay as they were tracked if those explain the
    frames better in the (geometric) mean, and the fingers before the leap or the gap are followed forth
    instead, by the same rules: ones that were wrongly found in the last frames of a hand on a thigh had gone
    back by 60 frames, none of which spoke loudly enough alone.

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
    again = _FingersAgain(fitter, sequence, on_frame or (lambda number: None))
    for block in fitter.model.pose_blocks:
        if not is_hand(block):
            continue
        joints = np.array(block.joints)
        leaps = _leaps(tracked[:, joints]).tolist()
        returns = [after for _, after in gaps_of_hand(frames, block.name)]
        for found in sorted({*leaps, *returns}, reverse=True):
            leapt = found in leaps
            if leapt and not len(_leaps(poses[found - 1 : found + 1, joints])):
                continue  # gone back over already
            best = _best_seen(frames, block.name, found, 0 if leapt else SETTLING)
            hand = _FoundHand(block.name, joints, found, best, leapt)
            if not _followed(again, poses, hand, hand.best, hand.back):
                _followed(again, poses, hand, found - 1, range(found, len(frames)))
    changed = np.flatnonzero((poses != tracked).any(axis=(1, 2)))
    return {int(number): poses[number] for number in changed}


def _leaps(turns: Float[np.ndarray, "N J 3"]) -> Int[np.ndarray, " n"]:
    """Frames in which a joint stands elsewhere than in the one before."""
    return np.flatnonzero(_apart(turns[:-1], turns[1:]) > _LEAP) + 1


def _apart(ones: Float[np.ndarray, "N J 3"], others: Float[np.ndarray, "N J 3"]) -> Float[np.ndarray, " N"]:
    """The largest angle between joints, radians."""
    between = Rotation.from_rotvec(ones.reshape(-1, 3)).inv() * Rotation.from_rotvec(others.reshape(-1, 3))
    return between.magnitude().reshape(ones.shape[:-1]).max(axis=-1)


def _best_seen(frames: Sequence[SeenPose], hand: str, found: int, settling: int) -> int:
    """The frame after a hand was found, and has settled, that shows most of it before it is out of sight."""
    best, most = found, 0.0
    for number in range(found, min(found + settling + _SOON, len(frames))):
        share = _seen(frames[number], hand)
        if share <= NOT_SEEN:
            break
        if number < found + settling:
            best = number
        elif share > most:
            best, most = number, share
    return best


def _seen(frame: SeenPose, hand: str) -> float:
    return frame.signals[f"{hand}_seen"] if frame.tracked else 0.0


def _followed(
    again: _FingersAgain, poses: Float[np.ndarray, "N K 3"], hand: _FoundHand, source: int, numbers: range
) -> bool:
    """Lay the fingers of the frame ``source`` along others, in place; False where the scans refuse."""
    joints, laid = hand.joints, {}
    fingers, for_tracked = poses[source, joints], 0.0
    for number in numbers:
        # From where most is seen to where they were found, fingers are only laid anew.
        anew = numbers.step < 0 and number >= hand.found
        frame = again.sequence.frames[number]
        if not frame.tracked:
            break
        if _seen(frame, hand.name) > HARDLY_SEEN:
            found = again.solved(number, poses[number], hand, fingers)
            for_tracked += 0.0 if found is None else found[1].for_ones
            if found is None or found[1].clear:
                if not anew:
                    break
                fingers = poses[number, joints]
            else:
                fingers = found[0]
            if not anew and _apart(fingers[None], frame.pose[None, joints])[0] < _SAME:
                break
        laid[number] = fingers
    if for_tracked > 0:
        return False
    for number, turns in laid.items():
        poses[number, joints] = turns
    return True


@dataclass(frozen=True, eq=False)
class _FingersAgain:
    """Frames solved from other fingers; leaps that follow one another ask for the same ones again.

    Attributes:
        fitter: of the subject's model.
        sequence: what was tracked.
        on_frame: told the number of every frame that is solved.
        known: what was found, by all that it follows from.
    """

    fitter: FrameFitter
    sequence: TrackedSequence
    on_frame: Callable[[int], None]
    known: dict[tuple, tuple[Float[np.ndarray, "J 3"], Comparison] | None] = field(default_factory=dict)

    def solved(
        self, number: int, tracked: Float[np.ndarray, "K 3"], hand: _FoundHand,
        fingers: Float[np.ndarray, "J 3"],
    ) -> tuple[Float[np.ndarray, "J 3"], Comparison] | None:  # fmt: skip
        """A frame's fingers, solved for from those of its neighbour, and how what was tracked compares."""
        key = (hand.name, number, tracked.tobytes(), fingers.tobytes())
        if key not in self.known:
            self.on_frame(number)
            self.known[key] = self._solved(number, tracked, hand, fingers)
        return self.known[key]

    def _solved(
        self, number: int, tracked: Float[np.ndarray, "K 3"], hand: _FoundHand,
        fingers: Float[np.ndarray, "J 3"],
    ) -> tuple[Float[np.ndarray, "J 3"], Comparison] | None:  # fmt: skip
        scan = self.sequence.scan_of(number)
        if scan is None:
            return None
        points, back = frame_points(scan, self.fitter.options), scan_surface(scan)
        pose, place = tracked.copy(), self.sequence.translations[number]
        pose[hand.joints] = fingers
        vector, begin = (np.concatenate([place, one.ravel()]) for one in (tracked, pose))
        found = self.fitter.fingers_again(points, vector, FrameStart(begin, pose, back=back), hand.name)
        if found is None:
            return None
        return self.fitter.fields.parameters(found[0]).pose[hand.joints], found[1]
