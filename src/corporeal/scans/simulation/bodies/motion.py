"""What a person does in a sequence: a recorded clip, recorded fingers, and how flesh follows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from corporeal.scans.simulation.bodies.files import BodySimulator, RecordedClip

FPS = 60.0
_FINGER_STEPS = 2  # frames of ours for one of the recorded fingers
# Faster turns of a joint from frame to frame, radians, are slips of the recording's markers (up to 164
# degrees). The fastest of runs and jumps, which have no slips, is 18 degrees.
_SLIP = np.radians(20)
# Of the way along the ground that is slower than this many frames, about so many metres are left.
_SLOW, _ROOM = 40.0, 0.45


@dataclass(frozen=True, eq=False)
class BodyMotion:
    """Poses of N frames, 60 a second.

    Attributes:
        pose: (N, 55, 3) axis-angle in SMPL-X's order against the open body's T-pose, radians.
        translation: (N, 3) of the root, metres, for a person of mean leg length.
    """

    pose: Float[np.ndarray, "N 55 3"]
    translation: Float[np.ndarray, "N 3"]


def body_motion(
    simulator: BodySimulator, clip: RecordedClip, frames: int, generator: np.random.Generator
) -> BodyMotion:
    """A window of a clip, turned about the vertical; where the clip is too short, it is played to and fro.

    No window reaches over a slip of the recording. People stay in the scanner as on a
    treadmill: of the slow part of their way along the ground only half a metre to either side is left.
    """
    stretch = _stretch(clip.pose, frames, generator)
    window = stretch.start + _window(stretch.stop - stretch.start, frames, generator)
    way, along = clip.translation.copy(), np.linspace(-1, 1, len(clip.translation))
    for axis in (0, 2):
        steady = np.polyval(np.polyfit(along, way[:, axis], 1), along)
        slow = steady + gaussian_filter1d(way[:, axis] - steady, _SLOW, mode="nearest")
        way[:, axis] += _ROOM * np.tanh(slow / _ROOM) - slow
    heading = Rotation.from_rotvec([0, generator.uniform(0, 2 * np.pi), 0])
    pose = np.zeros((frames, 55, 3))
    pose[:, :22] = clip.pose[window]
    pose[:, 0] = (heading * Rotation.from_rotvec(pose[:, 0])).as_rotvec()
    right, left = (_fingers(simulator, frames, generator) for _ in range(2))
    pose[:, 40:] = right
    # A turn's mirror image at x = 0.
    pose[:, 25:40] = left * [1, -1, -1]
    return BodyMotion(pose, heading.apply(way[window]))


def _stretch(pose: Float[np.ndarray, "T 22 3"], frames: int, generator: np.random.Generator) -> slice:
    """A stretch between two slips that holds so many frames, the longest where none does."""
    count, joints = pose.shape[:2]
    before, after = (Rotation.from_rotvec(part.reshape(-1, 3)) for part in (pose[:-1], pose[1:]))
    turns = (before.inv() * after).magnitude().reshape(count - 1, joints)
    ends = [*(np.flatnonzero(turns.max(axis=1) > _SLIP) + 1).tolist(), count]
    stretches = [slice(first, last) for first, last in zip([0, *ends[:-1]], ends, strict=True)]
    lengths = np.array([part.stop - part.start for part in stretches])
    enough = np.flatnonzero(lengths >= min(frames, lengths.max()))
    return stretches[int(generator.choice(enough))]


def _window(length: int, frames: int, generator: np.random.Generator) -> np.ndarray:
    """Numbers of frames: a stretch of the recording, or the recording to and fro from a frame in it."""
    start = int(generator.integers(max(length - frames, 0) + 1))
    if frames <= length:
        return start + np.arange(frames)
    period = max(2 * length - 2, 1)
    along = np.arange(frames) % period
    return np.where(along < length, along, period - along)


def _fingers(simulator: BodySimulator, frames: int, generator: np.random.Generator) -> np.ndarray:
    """(frames, 15, 3) of a right hand."""
    lengths = np.array([len(run) for run in simulator.finger_runs], dtype=float)
    run = simulator.finger_runs[int(generator.choice(len(lengths), p=lengths / lengths.sum()))]
    fine = np.arange(_FINGER_STEPS * (len(run) - 1) + 1) / _FINGER_STEPS
    low = np.minimum(fine.astype(int), len(run) - 2)
    share = (fine - low)[:, None, None]
    return ((1 - share) * run[low] + share * run[low + 1])[_window(len(fine), frames, generator)]
