"""What ``corporeal track`` would have left of the hand in motion, without the time that tracking takes."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path

import numpy as np

from corporeal.fitting.files import FrameRecord, frame_path, save_subject_template, write_frame
from corporeal.fitting.subject_template import SubjectTemplate
from corporeal.fitting.track import TrackedFrame, TrackState
from corporeal.model.files import load_model

_PATH = Path(__file__).with_name("made_sequence.py")
_SPEC = importlib.util.spec_from_file_location("made_sequence", _PATH)
made_sequence = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(made_sequence)


def make_track(sequence: Path, output: Path, count: int, statuses: dict[int, str] | None = None) -> Path:
    """Writes OUTPUT/NAME for a sequence of ``made_sequence``; frames not in ``statuses`` are ok."""
    model = load_model(sequence.parent / "template.npz")
    content = json.loads((sequence / "sequence.json").read_text())
    folder = output / content["name"]
    pose, place = made_sequence.motion(model, 0)
    template = SubjectTemplate(model, np.zeros(0), (), {}, pose, place)
    facts = {"name": content["name"], "folder": str(sequence), "fps": content["fps"], "subject": "s"}
    listed = [[frame["name"], frame["file"]] for frame in content["frames"]]
    story = {"unit": "mm", "made_from": {"frames": listed}, "sequence": facts, "scans": {}, "start": {}}
    save_subject_template(folder, template, story)
    for number in range(count):
        write_made_frame(folder, model, number, (statuses or {}).get(number, "ok"))
    return folder


def write_made_frame(folder: Path, model, number: int, status: str = "ok") -> None:
    """The record of one frame, with its true pose."""
    pose, place = made_sequence.motion(model, number)
    lost = status == "failed"
    s2m = None if lost else {"mean": 0.5 + number, "median": 0.4, "p95": 1.0, "under_1mm": 0.9}
    frame = TrackedFrame(
        f"{number:04d}", status, "" if status == "ok" else f"because {number}", pose, place, s2m,
        {"total": 0.1}, {"model_seen": 0.9, "right_hand_seen": 0.8},
    )  # fmt: skip
    state = TrackState(pose, place, True, np.zeros_like(pose), np.zeros(3), np.zeros(1, dtype=np.int64))
    write_frame(frame_path(folder, frame.name), FrameRecord(frame, state))
