"""Motion in the key layout of AMASS: what programs that read that archive expect of a file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float

from corporeal.model.formats.archive import write_archive

Gender = Literal["neutral", "female", "male"]

# Joints of a tree -> the name that AMASS gives to a model with so many.
_MODEL_TYPES = {22: "smpl", 52: "smplh", 55: "smplx"}
# Where the parts of SMPL-X's 165 numbers lie, by their names in the newer files of AMASS.
_SMPLX_PARTS = {
    "root_orient": slice(0, 3),
    "pose_body": slice(3, 66),
    "pose_jaw": slice(66, 69),
    "pose_eye": slice(69, 75),
    "pose_hand": slice(75, 165),
}
_SMPLH_PARTS = {"root_orient": slice(0, 3), "pose_body": slice(3, 66), "pose_hand": slice(66, 156)}
_PARTS: dict[str, dict[str, slice]] = {"smplh": _SMPLH_PARTS, "smplx": _SMPLX_PARTS}


@dataclass(frozen=True, eq=False)
class Motion:
    """A sequence of poses of one subject; N frames, K joints.

    Attributes:
        poses: (N, K, 3) axis-angle of every joint, the root first, radians.
        translations: (N, 3) metres; the root turns about its own rest joint, as in SMPL.
        betas: shape coefficients, the same in all frames.
        fps: frames per second.
        gender: of the model.
    """

    poses: Float[np.ndarray, "N K 3"]
    translations: Float[np.ndarray, "M 3"]
    betas: Float[np.ndarray, " s"]
    fps: float
    gender: Gender = "neutral"


def amass_arrays(motion: Motion) -> dict[str, np.ndarray]:
    """The keys of AMASS's files.

    SMPL+H files (2019) have ``poses``, ``betas``, ``trans``, ``mocap_framerate`` and ``gender``; SMPL-X
    files (2021) ``mocap_frame_rate``, ``mocap_time_length``, ``surface_model_type``, ``num_betas`` and the
    parts of the pose beside ``poses``. The two agree where both have a key, so that all are written. What
    AMASS knows of markers and of soft tissue (``markers_*``, ``dmpls``) is left out: there is none. A tree of
    another number of joints than 22, 52 and 55 is of the type "other" and has ``poses`` alone.

    Raises:
        ValueError: numbers of frames that differ, NaN or infinite numbers, or a frame rate that is not
            positive.
    """
    frames, joints = motion.poses.shape[:2]
    if motion.translations.shape[0] != frames:
        raise ValueError(f"translations: {motion.translations.shape[0]} for {frames} frames")
    for name, numbers in (
        ("poses", motion.poses), ("translations", motion.translations), ("betas", motion.betas)
    ):  # fmt: skip
        if not np.isfinite(numbers).all():
            raise ValueError(f"{name}: holds NaN or infinite numbers")
    if not (np.isfinite(motion.fps) and motion.fps > 0):
        raise ValueError(f"fps: expected a positive number, got {motion.fps}")
    kind = _MODEL_TYPES.get(joints, "other")
    poses = motion.poses.reshape(frames, 3 * joints).astype(np.float64)
    rate = np.array(float(motion.fps))
    return {
        "poses": poses,
        "betas": motion.betas.astype(np.float64),
        "num_betas": np.array(len(motion.betas)),
        "trans": motion.translations.astype(np.float64),
        "mocap_framerate": rate,
        "mocap_frame_rate": rate,
        "mocap_time_length": np.array(frames / motion.fps),
        "gender": np.array(motion.gender),
        "surface_model_type": np.array(kind),
        **{name: poses[:, columns] for name, columns in _PARTS.get(kind, {}).items()},
    }


def write_amass(path: Path | str, motion: Motion, more: Mapping[str, np.ndarray] | None = None) -> None:
    """Write the keys of AMASS, and others beside them, as a compressed ``.npz``; equal content, equal bytes.

    Args:
        path: the file; its folder is made if it is missing.
        motion: what to write.
        more: arrays of further keys; none may be one of AMASS's.

    Raises:
        ValueError: as for ``amass_arrays``, or a further key that AMASS has already.
        OSError: the file cannot be written.
    """
    arrays, more = amass_arrays(motion), more or {}
    taken = sorted(set(arrays) & set(more))
    if taken:
        raise ValueError(f"more: {taken[0]!r} is a key of AMASS")
    write_archive(Path(path), {**arrays, **more})
