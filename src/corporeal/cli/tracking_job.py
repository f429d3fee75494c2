"""One sequence from its first frame to its files: what every worker of ``corporeal track`` runs."""

from __future__ import annotations

import dataclasses
import time
import traceback
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numba
import numpy as np
import torch

from corporeal.cli.tracking_folder import SHEET, mesh_path, remove_leftovers, resumed, waiting_lock
from corporeal.cli.tracking_outputs import failed_outcome, sequence_facts, write_outputs
from corporeal.cli.tracking_start import (
    SequenceError,
    first_frame,
    given_template,
    learned_template,
    read_frame_scan,
)
from corporeal.fitting.bridged_records import bridge_records
from corporeal.fitting.files import (
    FrameRecord,
    TrackFileError,
    frame_path,
    load_subject_template,
    read_story,
    save_subject_template,
    update_story,
    write_frame,
)
from corporeal.fitting.found_fingers import found_fingers
from corporeal.fitting.frame_fit import FrameFitter
from corporeal.fitting.options import TrackingOptions
from corporeal.fitting.subject_template import SubjectTemplate
from corporeal.fitting.track import TrackedFrame, Tracker
from corporeal.model.files import ModelFileError
from corporeal.model.surface_model import SurfaceModel
from corporeal.registration.session.files import SessionFolderError
from corporeal.registration.session.jobs import WorkerError
from corporeal.scans.formats.sequence import ScanSequence, SequenceFrame
from corporeal.scans.scan import Scan
from corporeal.scans.units import UnitChoice
from corporeal.terms.model_fields import ModelParameters


@dataclass(frozen=True, eq=False)
class SequenceJob:
    """One sequence to track.

    Attributes:
        sequence: the frames that are asked for.
        folder: of its results.
        options: of tracking.
        made_from: all that the results follow from.
    """

    sequence: ScanSequence
    folder: Path
    options: TrackingOptions
    made_from: Mapping[str, Any]

    @property
    def name(self) -> str:
        """Of the sequence."""
        return self.sequence.name


@dataclass(frozen=True, eq=False)
class TrackingSetup:
    """How sequences are tracked; sent once to every worker.

    Attributes:
        model: the body, or the subject's own where ``personal``.
        personal: whether the model is the template, so that none is learned.
        known_start: parameters in the first frame with a scan, or None to register it.
        meshes: write a mesh per frame.
    """

    model: SurfaceModel
    personal: bool = False
    known_start: ModelParameters | None = None
    meshes: bool = False

    def start(self) -> SequenceWorker:
        """A worker for this process."""
        return SequenceWorker(self)


class SequenceWorker:
    """Tracks sequences one after the other; it writes their folders itself, frame by frame.

    What it tells: ``{"step": words}``, ``{"note": sentence}``, and for every frame ``{"done": count,
    "statuses": {...}}``.
    """

    def __init__(self, setup: TrackingSetup) -> None:
        self._setup = setup
        self.tell: Callable[[dict[str, Any]], None] = lambda content: None

    def close(self) -> None:
        """There is nothing to let go of."""

    def __call__(self, job: SequenceJob) -> dict[str, Any]:
        """Track one sequence; gives its outcome. One that cannot be tracked has a failed item.

        Raises:
            WorkerError: the files cannot be written.
        """
        # numba's number is each thread's own, and dask chooses the thread.
        numba.set_num_threads(1)
        torch.set_num_threads(1)
        try:
            with waiting_lock(job.folder, self._step):
                remove_leftovers(job.folder)
                return self._outcome(job)
        except (EOFError, BrokenPipeError, ConnectionResetError):
            raise  # nobody listens any more
        except (OSError, ModelFileError, SessionFolderError) as error:
            raise WorkerError(f"{job.folder}: {error}") from error

    def _outcome(self, job: SequenceJob) -> dict[str, Any]:
        try:
            return self._tracked(job)
        except (SequenceError, TrackFileError) as error:
            return failed_outcome(job.sequence, job.folder, str(error))
        except (OSError, EOFError, ModelFileError):
            raise
        except Exception as error:
            # One sequence must never cost the others; a fault of ours is reported as one, with its place.
            return failed_outcome(job.sequence, job.folder, _internal(error))

    def _tracked(self, job: SequenceJob) -> dict[str, Any]:
        template, unit = self._template(job)
        sequence = dataclasses.replace(job.sequence, unit=unit)
        done = resumed(job.folder, sequence)
        for sentence in done.notes:
            self.tell({"note": sentence})
        tracker, statuses = Tracker(template, job.options, done.state), Counter(done.statuses)
        self._told(done.count, statuses)
        for number, frame in enumerate(sequence.frames[done.count :], start=done.count + 1):
            record = self._frame(tracker, frame, unit)
            write_frame(frame_path(job.folder, frame.name), record)
            statuses[record.frame.status] += 1
            self._told(number, statuses)
        gaps = self._mended(job, sequence, tracker.fitter)
        self._step("writing")
        sequence = dataclasses.replace(sequence, notes=(*sequence.notes, *gaps))
        return write_outputs(sequence, job.folder, template, self._setup.meshes, self._step)

    def _mended(self, job: SequenceJob, sequence: ScanSequence, fitter: FrameFitter) -> list[str]:
        """Mend in the records what only the whole sequence tells; sentences for the user."""
        files = {frame.name: frame for frame in sequence.frames}
        found: dict[str, np.ndarray] = {}
        try:
            found = found_fingers(
                job.folder, list(files), fitter,
                lambda name: read_frame_scan(files[name], self._setup.model, sequence.unit).scan,
                lambda name: self._step(f"looking for fingers again: {name}"),
            )  # fmt: skip
        except (OSError, EOFError, TrackFileError):
            raise
        except Exception as error:
            # All frames are tracked: what stumbles over them afterwards must not cost them.
            self.tell({"note": f"fingers stay as they were tracked: {_internal(error)}"})
        self._step("bridging gaps")
        return bridge_records(
            job.folder, list(files), fitter.model, sequence.fps, found,
            lambda name: mesh_path(job.folder, name).unlink(missing_ok=True),
        )  # fmt: skip

    def _frame(self, tracker: Tracker, frame: SequenceFrame, unit: UnitChoice) -> FrameRecord:
        begun = time.perf_counter()
        read = read_frame_scan(frame, self._setup.model, unit)
        reading = time.perf_counter() - begun
        found = _stepped(tracker, frame.name, read.scan, read.reason)
        seconds = {**found.seconds, "read": reading, "total": reading + found.seconds["total"]}
        return FrameRecord(
            dataclasses.replace(found, seconds=seconds), tracker.state, read.sha256, read.stamp
        )  # fmt: skip

    def _template(self, job: SequenceJob) -> tuple[SubjectTemplate, UnitChoice]:
        """The subject's template: an earlier run's, else a new one, always as the disk has it; the unit."""
        story = read_story(job.folder)
        if story is None:
            story = self._make_template(job)
        else:
            # Frames were added, or the scans have moved: all else would have been refused.
            now = {"made_from": job.made_from, "sequence": sequence_facts(job.sequence)}
            if any(story.get(key) != content for key, content in now.items()):
                update_story(job.folder, now)
        return load_subject_template(job.folder), story["unit"]

    def _make_template(self, job: SequenceJob) -> dict[str, Any]:
        setup, begun = self._setup, time.perf_counter()
        start = first_frame(job.sequence, setup.model, job.options, setup.known_start, self._step)
        registered = time.perf_counter()
        if start.story.get("status") == "doubtful":
            where = f"{start.story['frame']}, where it starts, was registered doubtfully"
            self.tell({"note": f"{where}: {start.story['reason']}; look at {SHEET}"})
        sequence = dataclasses.replace(job.sequence, unit=start.unit)
        scans: dict[str, Any] = {}
        if setup.personal:
            template = given_template(setup.model, start)
        else:
            template, scans = learned_template(sequence, setup.model, job.options, start, self._step)
        ended = time.perf_counter()
        story: dict[str, Any] = {
            "unit": start.unit,
            "made_from": dict(job.made_from),
            "sequence": sequence_facts(job.sequence),
            "learned": not setup.personal,
            "start": start.story,
            "scans": scans,
            "seconds": {"registration": registered - begun, "template": ended - registered},
        }
        save_subject_template(job.folder, template, story)
        return story

    def _step(self, words: str) -> None:
        self.tell({"step": words})

    def _told(self, done: int, statuses: Counter[str]) -> None:
        self.tell({"done": done, "statuses": dict(statuses)})


def _stepped(tracker: Tracker, name: str, scan: Scan | None, reason: str) -> TrackedFrame:
    """A frame that makes the solver stumble is lost, and the next goes on from the last good one."""
    try:
        return tracker.step(scan, name, reason or "no scan")
    except Exception as error:
        return tracker.step(None, name, _internal(error))


def _internal(error: Exception) -> str:
    place = traceback.extract_tb(error.__traceback__)[-1]
    return f"internal error, please report it: {error!r} in {Path(place.filename).name}:{place.lineno}"
