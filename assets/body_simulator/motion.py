"""Recorded motion for the simulator: bodies (CMU) on 22 joints, 60 frames per second, and fingers (Intel)."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from open_body.recorded_motion import TEST_CLIPS, MovedBody, recorded_clips
from open_hand.recorded_poses import carried_over, read_poses

from corporeal.model.files import load_model

# What is seen in the clips that the open body's pose statistics leave out.
_CLIPS = {
    "01_14": "climb", "02_01": "walk", "02_03": "run", "02_04": "jump", "02_10": "wash", "03_02": "terrain",
}  # fmt: skip
_ANGLE_UNIT, _LENGTH_UNIT = 2e-4, 1e-4
# Between frames of one run of the recorded fingers no joint turns farther; shorter runs are left out.
_LEAP, _SHORTEST = np.deg2rad(20.0), 70
# The recording trembles: smoothed over so many frames (standard deviation).
_SMOOTH = 1.5
_FINGERS = ("index", "middle", "little", "ring", "thumb")


def body_clips(folder: Path, body_file: Path) -> dict[str, np.ndarray]:
    """Clips one after the other: pose (T, 22, 3) in units of 2e-4 rad, translation (T, 3) of 0.1 mm."""
    if set(_CLIPS) != set(TEST_CLIPS):
        raise SystemExit("the clips that statistics leave out have changed: name what is seen in them")
    model = load_model(body_file)
    joints = np.asarray(model.joint_regressor @ model.template)
    moved = MovedBody.of_surface(joints, model.template, np.asarray(model.skinning_weights))
    clips = [clip.every(2) for clip in recorded_clips(folder, moved, tuple(_CLIPS))]
    for clip in clips:
        extent = np.ptp(clip.translation, axis=0)
        print(f"clip {clip.name} {_CLIPS[clip.name]}: {len(clip.pose)} frames, extent {extent.round(2)} m")
    return {
        "clip_names": np.array([_CLIPS[clip.name] for clip in clips]),
        "clip_sources": np.array([clip.name for clip in clips]),
        "clip_lengths": np.array([len(clip.pose) for clip in clips], dtype=np.int32),
        "clip_pose": _short(np.concatenate([_continuous(clip.pose) for clip in clips]), _ANGLE_UNIT),
        "clip_translation": _short(
            np.concatenate([_centred(clip.translation) for clip in clips]), _LENGTH_UNIT
        ),
    }


def finger_runs(folder: Path) -> dict[str, np.ndarray]:
    """Unbroken runs of recorded fingers: (n, 15, 3) axis-angle of a right hand in units of 2e-4 rad."""
    model = load_model(Path(__file__).resolve().parents[2] / "src/corporeal/model/open_models/start_hand.npz")
    joints = np.asarray(model.joint_regressor @ model.template)
    marks = model.landmarks["hand_21_mediapipe"]
    positions = dict(zip(marks.names, marks.positions(model.template, joints), strict=True))
    tips = np.array(
        [positions[next(n for n in marks.names if finger in n and "tip" in n)] for finger in _FINGERS]
    )
    poses = carried_over(read_poses(folder), joints, tips).reshape(-1, 15, 3)
    turns = Rotation.from_rotvec(poses.reshape(-1, 3))
    quaternions = turns.as_quat().reshape(-1, 15, 4)
    cosine = np.abs(np.sum(quaternions[1:] * quaternions[:-1], axis=2)).clip(0, 1)
    breaks = np.flatnonzero((2 * np.arccos(cosine)).max(1) > _LEAP) + 1
    runs = [run for run in np.split(np.arange(len(poses)), breaks) if len(run) >= _SHORTEST]
    smooth = [gaussian_filter1d(_continuous(poses[run]), _SMOOTH, axis=0, mode="nearest") for run in runs]
    print(f"fingers: {len(runs)} runs of {[len(run) for run in runs]} frames")
    return {
        "finger_lengths": np.array([len(run) for run in runs], dtype=np.int32),
        "finger_pose": _short(np.concatenate(smooth), _ANGLE_UNIT),
    }


def _continuous(pose: np.ndarray) -> np.ndarray:
    """Axis-angles (T, K, 3) without leaps of a whole turn."""
    out = pose.copy()
    for t in range(1, len(out)):
        angle = np.linalg.norm(out[t], axis=1, keepdims=True)
        axis = out[t] / np.maximum(angle, 1e-9)
        whole = np.round((np.sum(out[t - 1] * axis, axis=1, keepdims=True) - angle) / (2 * np.pi))
        out[t] += 2 * np.pi * whole * axis
    return out


def _centred(translation: np.ndarray) -> np.ndarray:
    """The way along the ground about its middle, so that the numbers stay small."""
    return translation - [1, 0, 1] * (translation.max(0) + translation.min(0)) / 2


def _short(values: np.ndarray, unit: float) -> np.ndarray:
    numbers = np.round(values / unit)
    if np.abs(numbers).max() > np.iinfo(np.int16).max:
        raise SystemExit(f"numbers up to {np.abs(values).max():.2f} do not fit")
    return numbers.astype(np.int16)
