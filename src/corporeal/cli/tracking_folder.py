"""The folder of a tracked sequence: what it was made from, whether it still holds, and where to go on."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import corporeal
from corporeal.fitting.files import (
    FRAMES,
    TEMPLATE,
    TEMPLATE_STORY,
    FrameRecord,
    TrackFileError,
    frame_path,
    read_frame,
    read_story,
)
from corporeal.fitting.found_fingers import FINGERS
from corporeal.fitting.track import TrackState
from corporeal.registration.session.files import SessionFolderError, file_stamps, sha256_of
from corporeal.registration.session.lock import folder_lock
from corporeal.registration.session.manifest import changes_between
from corporeal.scans.formats.sequence import ScanSequence

TRACK, ANIMATION, SHEET, REPORT, MESHES = "track.npz", "track.glb", "sheet.png", "report.json", "meshes"
_PUT_BACK = "put it back, choose another folder, or redo all with --restart"
# An orphan of a killed run ends when it next tells of itself: within a frame, or a stage of registration.
_PATIENCE = 180.0


class TrackFolderError(ValueError):
    """What a folder holds cannot be continued; the message names it and says what to do."""


@dataclass(frozen=True, eq=False)
class Resumed:
    """How much of a sequence is done.

    Attributes:
        count: frames from the first on whose records hold.
        state: of the tracker after them; None before the first.
        statuses: how many of them are ok, doubtful and failed.
        notes: what the user should know.
    """

    count: int
    state: TrackState | None
    statuses: Counter[str]
    notes: tuple[str, ...]


def mesh_path(folder: Path, name: str) -> Path:
    """Where the mesh of a frame lies."""
    return folder / MESHES / f"{name}.ply"


def made_from(sequence: ScanSequence, how: Mapping[str, Any]) -> dict[str, Any]:
    """All that the results follow from, of JSON's types; it stands in ``template.json``.

    Args:
        sequence: what is tracked.
        how: model, start and options.
    """
    frames = [[frame.name, str(frame.path.relative_to(sequence.folder))] for frame in sequence.frames]
    return {
        **how,
        "unit": sequence.unit,
        "frames": frames,
        "versions": {"corporeal": corporeal.__version__, "numpy": np.__version__},
    }


def check_folder(folder: Path, sequence: ScanSequence, now: Mapping[str, Any]) -> list[str]:
    """Whether what a folder holds may be continued. Frames may be added; another version is said.

    Returns:
        Sentences for the user.

    Raises:
        TrackFolderError: model, options, the start, known frames or scans of the template are others now.
        TrackFileError: ``template.json`` cannot be read.
    """
    story = read_story(folder)
    if story is None:
        if any((folder / FRAMES).glob("*.npz")):
            raise TrackFolderError(
                f"{folder}: holds frames but no {TEMPLATE_STORY}, so that it is not known what they were "
                "made from; choose another folder, or redo all with --restart"
            )
        return []
    before = story["made_from"]
    apart = ("frames", "versions")
    changes = changes_between(
        *({key: value for key, value in made.items() if key not in apart} for made in (before, now))
    )
    known, frames = before["frames"], now["frames"]
    changes += [
        f"frame {number}: {old[0]} ({old[1]}) -> {' '.join(new)}"
        for number, old in enumerate(known)
        if (new := frames[number] if number < len(frames) else ["absent"]) != list(old)
    ]
    scans = {frame.name: frame.path for frame in sequence.frames}
    changes += [
        f"{scans[name].name}, which the template was learned from"
        for name, scan in story.get("scans", {}).items()
        if name in scans and has_changed(scans[name], scan["sha256"], tuple(scan["stamp"]))
    ]
    if changes:
        shown = "; ".join(changes[:6]) + ("; ..." if len(changes) > 6 else "")
        raise TrackFolderError(
            f"{folder}: since these results were begun, this has changed: {shown}; {_PUT_BACK}"
        )
    notes = [f"another version of {line}" for line in changes_between(before["versions"], now["versions"])]
    added = len(frames) - len(known)
    return notes + ([f"{added} frames were added to the sequence"] if added else [])


def resumed(folder: Path, sequence: ScanSequence) -> Resumed:
    """Find the frames that are done, and remove the records of all behind the first that is not.

    Every frame starts from the one before it: what follows a changed one no longer holds.
    """
    count, state, statuses, notes = 0, None, Counter[str](), []
    for frame in sequence.frames:
        try:
            record = read_frame(frame_path(folder, frame.name))
        except FileNotFoundError:
            break
        except (TrackFileError, OSError):
            notes.append(f"the record of {frame.name} was damaged; it is tracked again from there")
            break
        if has_changed(frame.path, record.sha256, record.stamp):
            notes.append(f"{frame.path.name} has changed since; it is tracked again from there")
            break
        count, state = count + 1, record.state
        statuses[record.frame.status] += 1
    for frame in sequence.frames[count:]:
        frame_path(folder, frame.name).unlink(missing_ok=True)
        mesh_path(folder, frame.name).unlink(missing_ok=True)
    return Resumed(count, state, statuses, tuple(notes))


def records_of(folder: Path, sequence: ScanSequence) -> Iterator[FrameRecord]:
    """All records in the order of the frames, one at a time."""
    for frame in sequence.frames:
        yield read_frame(frame_path(folder, frame.name))


def stamp_of(path: Path) -> tuple[int, int] | None:
    """Size and time of the last change in ns, or None where there is no file."""
    stamp = file_stamps({"scan": path})["scan"]
    return None if stamp is None else (stamp[0], stamp[1])


def has_changed(path: Path, sha256: str | None, stamp: tuple[int, ...] | None) -> bool:
    """Whether a scan's file is another than it was; one that is gone keeps its result.

    Size and time tell, as for make; where they differ, as in a copied sequence, the content decides.
    """
    now = stamp_of(path)
    return now is not None and now != stamp and sha256_of(path) != sha256


def remove_results(folder: Path) -> None:
    """Clear a folder for a new start, the template's story last."""
    for pattern in (f"{FRAMES}/*.npz", f"{MESHES}/*.ply"):
        for path in folder.glob(pattern):
            path.unlink()
    for name in (TRACK, ANIMATION, SHEET, REPORT, FINGERS, TEMPLATE, TEMPLATE_STORY):
        (folder / name).unlink(missing_ok=True)


def remove_leftovers(folder: Path) -> None:
    """Drop the temporary files of a process that was killed while it wrote."""
    for where in (folder, folder / FRAMES, folder / MESHES):
        for path in where.glob(".*.tmp"):
            path.unlink(missing_ok=True)


@contextmanager
def waiting_lock(folder: Path, tell: Callable[[str], None]) -> Iterator[None]:
    """Hold a sequence's folder; wait for a worker whose run was killed: it ends within a step.

    Raises:
        SessionFolderError: it is still held after minutes.
        OSError: the folder cannot be written.
    """
    ends, told = time.monotonic() + _PATIENCE, False
    while True:
        lock = folder_lock(folder)
        try:
            lock.__enter__()
            break
        except SessionFolderError:
            if time.monotonic() > ends:
                raise
            if not told:
                tell("waits for a worker of a run that was stopped")
                told = True
            time.sleep(0.1)
    try:
        yield
    finally:
        lock.__exit__(None, None, None)
