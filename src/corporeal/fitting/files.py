"""A tracked sequence on disk: the subject's template, and one small record per frame."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from corporeal.atomic import write_bytes
from corporeal.fitting.subject_template import SubjectTemplate
from corporeal.fitting.track import Status, TrackedFrame, TrackState
from corporeal.model.files import ModelFileError, load_model, save_model
from corporeal.model.formats.archive import write_archive

FORMAT = "corporeal-track-2"
TEMPLATE = "template.npz"
TEMPLATE_STORY = "template.json"
"""Written after the template: where it is, the template is whole."""
FRAMES = "frames"
# Offsets are kept in steps so large, metres: a twentieth of the noise of a body scanner.
_STEP = 5e-5
_STATUSES: dict[str, Status] = {"ok": "ok", "doubtful": "doubtful", "failed": "failed"}


class TrackFileError(ValueError):
    """A file of a tracked sequence cannot be read; the message names it and says what to do."""


@dataclass(frozen=True, eq=False)
class FrameRecord:
    """What is kept of a frame.

    Attributes:
        frame: the result.
        state: of the tracker after it: all that is needed to go on with the next.
        sha256: of the scan's file; None where it could not be read.
        stamp: size in bytes and time of change in ns of the scan's file; None where it was missing.
    """

    frame: TrackedFrame
    state: TrackState
    sha256: str | None = None
    stamp: tuple[int, int] | None = None


def frame_path(folder: Path | str, name: str) -> Path:
    """Where the record of a frame lies in the folder of a tracked sequence."""
    return Path(folder) / FRAMES / f"{name}.npz"


def write_frame(path: Path | str, record: FrameRecord) -> None:
    """Write a record whole or not at all; the same record gives the same bytes.

    Keys: ``name``, ``status``, ``reason``; ``pose`` (K, 3) and ``translation`` (3,), radians and metres;
    ``s2m_mm``, ``signals`` and ``seconds``, each an object in JSON; ``offsets`` (V, 3) in steps of 50
    micrometres, (0, 3) where there are none; ``state_*`` the fields of ``TrackState``; ``sha256`` (empty
    where there was no scan) and ``stamp`` of the scan's file (-1 where it was missing).

    Raises:
        OSError: it cannot be written.
    """
    frame, state = record.frame, record.state
    words = {"name": frame.name, "status": frame.status, "reason": frame.reason}
    objects = {"s2m_mm": frame.s2m_mm, "signals": frame.signals, "seconds": frame.seconds}
    arrays = {key: np.array(text) for key, text in words.items()}
    arrays |= {key: np.array(json.dumps(content, sort_keys=True)) for key, content in objects.items()}
    arrays |= {
        "pose": frame.pose,
        "translation": frame.translation,
        "offsets": _in_steps(frame.offsets),
        "state_pose": state.pose,
        "state_translation": state.translation,
        "state_fitted": np.array(state.fitted),
        "state_turned": state.turned,
        "state_moved": state.moved,
        "state_settling": state.settling,
        "sha256": np.array(record.sha256 or ""),
        "stamp": np.array(record.stamp or (-1, -1), dtype=np.int64),
    }
    write_archive(Path(path), arrays)


def _in_steps(offsets: np.ndarray | None) -> np.ndarray:
    if offsets is None:
        return np.zeros((0, 3), dtype=np.int16)
    steps = np.round(offsets / _STEP)
    limits = np.iinfo(np.int16)
    # Farther than any person is tall; the widest numbers keep it all the same.
    small = limits.min <= steps.min() and steps.max() <= limits.max
    return steps.astype(np.int16 if small else np.int64)


def read_frame(path: Path | str) -> FrameRecord:
    """Read what ``write_frame`` wrote.

    Raises:
        TrackFileError: it is damaged, or no such record.
        FileNotFoundError: there is none.
        OSError: it cannot be read.
    """
    content = Path(path).read_bytes()
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as archive:
            return _record({key: archive[key] for key in archive.files})
    except Exception as error:  # Damaged bytes make the zip, npy and JSON parsers raise nearly anything.
        trouble = f"is missing {error}" if isinstance(error, KeyError) else str(error)[:120]
        raise TrackFileError(
            f"{path}: damaged, or no record of a tracked frame ({trouble}); remove it and track again"
        ) from error


def _record(arrays: Mapping[str, np.ndarray]) -> FrameRecord:
    name, status, reason = (str(arrays[key]) for key in ("name", "status", "reason"))
    if status not in _STATUSES:
        raise ValueError(f"unknown status {status!r}")
    s2m_mm, signals, seconds = (json.loads(str(arrays[key])) for key in ("s2m_mm", "signals", "seconds"))
    state = TrackState(
        arrays["state_pose"],
        arrays["state_translation"],
        bool(arrays["state_fitted"]),
        arrays["state_turned"],
        arrays["state_moved"],
        arrays["state_settling"],
    )
    offsets = arrays["offsets"] * _STEP if len(arrays["offsets"]) else None
    frame = TrackedFrame(
        name, _STATUSES[status], reason, arrays["pose"], arrays["translation"], s2m_mm, seconds, signals,
        offsets,
    )  # fmt: skip
    size, changed = (int(number) for number in arrays["stamp"])
    return FrameRecord(frame, state, str(arrays["sha256"]) or None, None if size < 0 else (size, changed))


def save_subject_template(folder: Path, template: SubjectTemplate, story: Mapping[str, Any]) -> None:
    """Write the subject's model, then how it came about and where the sequence starts.

    Args:
        folder: of the tracked sequence.
        template: of the subject.
        story: further keys of the JSON file, of JSON's types.

    Raises:
        ModelFileError: the model cannot be written.
        OSError: the JSON file cannot be written.
    """
    save_model(template.model, folder / TEMPLATE)
    # JSON keeps every bit of a float64: the same start is read again.
    content = {
        "format": FORMAT,
        "used": list(template.used),
        "rejected": dict(template.rejected),
        "shape": template.shape.tolist(),
        "start_pose": template.start_pose.tolist(),
        "start_translation": template.start_translation.tolist(),
        "joint_shifts": None if template.joint_shifts is None else template.joint_shifts.tolist(),
        **story,
    }
    _write_story(folder, content)


def update_story(folder: Path, keys: Mapping[str, Any]) -> None:
    """Replace keys of ``template.json``.

    Raises:
        TrackFileError: there is none, or it cannot be read.
        OSError: it cannot be written.
    """
    story = read_story(folder)
    if story is None:
        raise TrackFileError(f"{folder}: holds no {TEMPLATE_STORY}")
    _write_story(folder, {**story, **keys})


def _write_story(folder: Path, content: Mapping[str, Any]) -> None:
    write_bytes(folder / TEMPLATE_STORY, (json.dumps(content, indent=1, allow_nan=False) + "\n").encode())


def read_story(folder: Path) -> dict[str, Any] | None:
    """What ``template.json`` says, or None where there is none yet.

    Raises:
        TrackFileError: it cannot be read, or is none of ours.
    """
    path = folder / TEMPLATE_STORY
    try:
        content = json.loads(path.read_text())
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        raise TrackFileError(f"{path}: cannot be read ({error}); use --restart") from error
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise TrackFileError(f'{path}: expected an object with "format": "{FORMAT}"; use --restart')
    return content


def load_subject_template(folder: Path) -> SubjectTemplate:
    """Read what ``save_subject_template`` wrote.

    Raises:
        TrackFileError: a file is missing or damaged.
    """
    story = read_story(folder)
    if story is None:
        raise TrackFileError(f"{folder}: holds no {TEMPLATE_STORY}; give a folder that corporeal track wrote")
    shifts = story.get("joint_shifts")
    try:
        return SubjectTemplate(
            load_model(folder / TEMPLATE),
            np.array(story["shape"], dtype=np.float64),
            tuple(story["used"]),
            dict(story["rejected"]),
            np.array(story["start_pose"], dtype=np.float64),
            np.array(story["start_translation"], dtype=np.float64),
            None if shifts is None else np.array(shifts, dtype=np.float64),
        )
    except (ModelFileError, KeyError, TypeError, ValueError) as error:
        raise TrackFileError(f"{folder}: its template cannot be read ({error}); use --restart") from error
