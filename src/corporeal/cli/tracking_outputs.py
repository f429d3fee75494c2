"""What ``corporeal track`` makes of the records of a sequence: motion, animation, picture, meshes, report."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from corporeal.cli.files import write_json
from corporeal.cli.tracking_folder import ANIMATION, MESHES, REPORT, SHEET, TRACK, mesh_path, records_of
from corporeal.cli.tracking_pictures import sheet_frames
from corporeal.export.amass import Gender, Motion, write_amass
from corporeal.export.animation import write_animation
from corporeal.export.meshes import write_ply
from corporeal.export.track_sheet import write_track_sheet
from corporeal.fitting.files import TEMPLATE, read_story
from corporeal.fitting.subject_template import SubjectTemplate
from corporeal.fitting.track import TrackedFrame
from corporeal.model.jacobian import evaluate
from corporeal.scans.formats.sequence import ScanSequence

_SEXES: dict[str, Gender] = {"female": "female", "male": "male"}
_STORY = ("learned", "used", "rejected", "shape", "joint_shifts", "start", "seconds")


def write_outputs(
    sequence: ScanSequence,
    folder: Path,
    template: SubjectTemplate,
    meshes: bool,
    on_step: Callable[[str], None],
) -> dict[str, Any]:
    """Write all that follows from the records, the report last.

    Args:
        sequence: whose frames all have a record.
        folder: of the results.
        template: of the subject.
        meshes: write a mesh per frame that did not fail, where it is missing.
        on_step: told what is written.

    Returns:
        The outcome: see ``outcome_of``.

    Raises:
        OSError: a file cannot be written.
    """
    # Without free vertices, which are half a megabyte each: memory must not grow with the length.
    frames = [dataclasses.replace(record.frame, offsets=None) for record in records_of(folder, sequence)]
    on_step(f"writing {TRACK}")
    _write_motion(folder / TRACK, sequence, template, frames)
    on_step(f"writing {ANIMATION}")
    poses, places = _moved(frames)
    summary = write_animation(
        folder / ANIMATION, template.model, np.zeros(0), poses, places, sequence.fps
    )  # fmt: skip
    if meshes:
        on_step(f"writing {MESHES}")
        _write_meshes(folder, sequence, template)
    on_step(f"writing {SHEET}")
    title = f"{sequence.name}: {len(frames)} frames, {_counted(frames)}"
    write_track_sheet(folder / SHEET, title, sheet_frames(sequence, folder, template.model))
    story = read_story(folder) or {}
    report = {
        "sequence": sequence_facts(sequence),
        "items": [frame_item(frame) for frame in frames],
        "template": {"file": TEMPLATE, **{key: story.get(key) for key in _STORY}},
        "animation": dataclasses.asdict(summary),
        "notes": [*sequence.notes, *_start_notes(story.get("start", {}))],
    }
    write_json(folder / REPORT, report)
    return outcome_of(report, folder)


def failed_outcome(sequence: ScanSequence, folder: Path, reason: str) -> dict[str, Any]:
    """Write the report of a sequence that cannot be tracked: one item of its own, whose frame is null."""
    item: dict[str, Any] = {
        "frame": None, "status": "failed", "reason": reason, "seconds": {}, "s2m_mm": None, "signals": {},
    }  # fmt: skip
    report = {
        "sequence": sequence_facts(sequence),
        "items": [item],
        "template": None,
        "notes": list(sequence.notes),
    }  # fmt: skip
    write_json(folder / REPORT, report)
    return outcome_of(report, folder)


def frame_item(frame: TrackedFrame) -> dict[str, Any]:
    """A frame's item of the report."""
    return {
        "frame": frame.name,
        "status": frame.status,
        "reason": frame.reason,
        "seconds": frame.seconds,
        "s2m_mm": frame.s2m_mm,
        "signals": frame.signals,
    }


def outcome_of(report: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """A few numbers of a report, for the summary.

    Keys: ``name``, ``folder``, ``statuses`` (counts), ``s2m_mm`` (mean over frames that did not fail, or
    None), ``seconds`` (mean per frame, or None) and ``reason`` (of a sequence that could not be tracked, or
    None).
    """
    items = [item for item in report["items"] if item["frame"] is not None]
    good = [item["s2m_mm"]["mean"] for item in items if item["status"] != "failed" and item["s2m_mm"]]
    seconds = [item["seconds"]["total"] for item in items]
    return {
        "name": report["sequence"]["name"],
        "folder": str(folder),
        "statuses": dict(Counter(item["status"] for item in items)),
        "s2m_mm": float(np.mean(good)) if good else None,
        "seconds": float(np.mean(seconds)) if seconds else None,
        "reason": None if items else report["items"][0]["reason"],
    }


def sequence_facts(sequence: ScanSequence) -> dict[str, Any]:
    """What is written down of a sequence: ``name``, ``folder``, ``fps``, ``subject``, ``frames``."""
    return {
        "name": sequence.name,
        "folder": str(sequence.folder),
        "fps": sequence.fps,
        "subject": sequence.subject,
        "frames": len(sequence.frames),
    }


def _start_notes(start: Mapping[str, Any]) -> list[str]:
    if not start:
        return []
    if start.get("given"):
        return [f"frame {start['frame']} starts from the parameters given"]
    verdict = f"registered {start['status']}" + (f" ({start['reason']})" if start["reason"] else "")
    return [f"frame {start['frame']}, where it starts: {verdict}", *start["notes"]]


def _moved(frames: list[TrackedFrame]) -> tuple[np.ndarray, np.ndarray]:
    """Poses and translations; frames that failed before the first good one stand as that one does."""
    good = (number for number, frame in enumerate(frames) if frame.status != "failed")
    first = next(good, 0)
    shown = [frames[first]] * first + frames[first:]
    return np.array([frame.pose for frame in shown]), np.array([frame.translation for frame in shown])


def _write_motion(
    path: Path, sequence: ScanSequence, template: SubjectTemplate, frames: list[TrackedFrame]
) -> None:
    poses, places = _moved(frames)
    gender = _SEXES.get(template.model.name.rpartition("_")[2], "neutral")
    motion = Motion(poses, places, template.shape, sequence.fps, gender)
    more = {
        "frame_names": np.array([frame.name for frame in frames]),
        "status": np.array([frame.status for frame in frames]),
        "template": np.array(TEMPLATE),
    }
    write_amass(path, motion, more)


def _write_meshes(folder: Path, sequence: ScanSequence, template: SubjectTemplate) -> None:
    """Metres, in the frame of the scans; a frame that failed has none."""
    for record in records_of(folder, sequence):
        frame = record.frame
        path = mesh_path(folder, frame.name)
        if frame.status == "failed" or path.exists():
            continue
        vertices = evaluate(template.model, np.zeros(0), frame.pose, frame.translation).vertices
        if frame.offsets is not None:
            vertices = vertices + frame.offsets
        write_ply(path, vertices.astype(np.float32), template.model.faces, comments=("unit: metres",))


def _counted(frames: list[TrackedFrame]) -> str:
    counts = Counter(frame.status for frame in frames)
    return ", ".join(f"{counts[status]} {status}" for status in ("ok", "doubtful", "failed"))
