"""``corporeal register FOLDER``: a capture session, one record per scan."""

from __future__ import annotations

import dataclasses
import math
import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn

from corporeal.cli.errors import CommandError
from corporeal.cli.files import check_result, write_result
from corporeal.cli.registration_outputs import write_outputs
from corporeal.model.files import ModelFileError, save_model
from corporeal.model.surface_model import Side, SurfaceModel
from corporeal.registration.registration import Registration
from corporeal.registration.session.cluster import DaskMissingError, run_dask
from corporeal.registration.session.files import MODEL, SessionFolderError, read_landmarks
from corporeal.registration.session.jobs import Execute, WorkerError
from corporeal.registration.session.model_digest import model_digest
from corporeal.registration.session.pool import run_local
from corporeal.registration.session.records import RecordError
from corporeal.registration.session.run import SessionPlan, Watcher, register_session
from corporeal.registration.session.tasks import RegistrationSetup
from corporeal.registration.subjects import subject_of
from corporeal.scans.files import SCAN_SUFFIXES
from corporeal.scans.formats.session import CaptureSession, SessionFileError, read_session
from corporeal.scans.units import UnitChoice

# Scans per second are counted over this long, so that a resumed or slowing session shows its present rate.
_RATE_WINDOW = 120.0


@dataclass(frozen=True)
class SessionCall:
    """What ``corporeal register`` was asked to do with a folder.

    Attributes:
        folder: of the session.
        output: folder of the results.
        workers: processes.
        rounds: 1, or 2 with the pose priors of the first.
        dask: address of a scheduler, "local", or None for the local pool.
        restart: throw away earlier results.
        outputs: write GLB, PLYs and a picture per scan too.
        side: of the scans whose side the session does not say, or None to find out.
        unit: of the files; "auto" takes the session's word for it.
        correctives: use the model's pose correctives.
        green_objects: drop green points.
        json: where to write the items too.
        landmarks_from: folder of an earlier registration whose landmarks are used again, or None.
    """

    folder: Path
    output: Path
    workers: int
    rounds: Literal[1, 2] = 1
    dask: str | None = None
    restart: bool = False
    outputs: bool = False
    side: Side | None = None
    unit: UnitChoice = "auto"
    correctives: bool = True
    green_objects: bool = False
    json: Path | None = None
    landmarks_from: Path | None = None


def run_session(call: SessionCall, model: SurfaceModel) -> int:
    """Register a session; 0 when every scan has a row, whatever its status.

    Raises:
        CommandError: the folders cannot be used, options have changed, or no worker can work.
        KeyboardInterrupt: stopped; all records written so far stay.
    """
    if call.workers < 1:
        raise CommandError(f"--workers {call.workers}: at least one is needed", 2)
    if call.json is not None:
        check_result(call.json)
    console = Console(stderr=True)
    begun = time.monotonic()
    try:
        session = read_session(call.folder, SCAN_SUFFIXES)
        with _Bar(console) as watcher:
            items = register_session(_plan(call, model, session, watcher))
        _keep_model(call.output / MODEL, model)
    except (SessionFileError, SessionFolderError, RecordError, DaskMissingError, ModelFileError) as error:
        raise CommandError(str(error), 2) from error
    except WorkerError as error:
        raise CommandError(f"{error}; what was done is kept, and the same command goes on") from error
    except KeyboardInterrupt:
        console.print("stopped; what was done is kept, and the same command goes on where it stopped")
        raise
    if call.json is not None:
        write_result(call.json, {"items": items})
    console.print(_summary(items, time.monotonic() - begun), highlight=False, soft_wrap=True, markup=False)
    return 0


def _keep_model(path: Path, model: SurfaceModel) -> None:
    """Copy the model into the folder once; another one would have been refused by now."""
    if not path.exists():
        save_model(model, path)


def _plan(call: SessionCall, model: SurfaceModel, session: CaptureSession, watcher: Watcher) -> SessionPlan:
    options = dataclasses.replace(subject_of(model).session_options(), correctives=call.correctives)
    unit = session.unit if call.unit == "auto" else call.unit
    setup = RegistrationSetup(
        model=model,
        options=options,
        unit=unit,
        side=call.side,
        green_objects=call.green_objects,
        write_outputs=_OutputWriter(call.output.resolve()) if call.outputs else None,
    )
    described = dataclasses.asdict(options) | {
        "unit": unit, "side": call.side, "green_objects": call.green_objects, "outputs": call.outputs,
    }  # fmt: skip
    execute: Execute = (
        partial(run_local, workers=call.workers)
        if call.dask is None
        else partial(run_dask, address=call.dask, workers=call.workers)
    )
    description = {
        "model": {"name": model.name, "side": model.side, "sha256": model_digest(model)},
        "options": _speakable(described),
    }
    known = {} if call.landmarks_from is None else read_landmarks(call.landmarks_from, described)
    return SessionPlan(
        session, call.output, setup, description, execute, call.rounds, call.restart, watcher, known
    )  # fmt: skip


@dataclass(frozen=True)
class _OutputWriter:
    """Writes the files of one scan in a worker; a class, so that it can be sent there."""

    folder: Path

    def __call__(self, result: Registration, row: dict[str, Any]) -> dict[str, str]:
        return write_outputs(result, self.folder / row["name"], row)


class _Bar(Watcher):
    """A progress bar with rate, time left and counts by status."""

    def __init__(self, console: Console) -> None:
        columns = (
            TextColumn("{task.description}"),
            BarColumn(),
            TextColumn("{task.completed:.0f}/{task.total:.0f}"),
            TextColumn("{task.fields[speed]}"),
            TextColumn("{task.fields[counts]}"),
        )
        self._console = console
        self._progress = Progress(*columns, console=console, transient=True)
        self._counts: Counter[str] = Counter()
        self._moments: list[float] = []

    def __enter__(self) -> _Bar:
        self._progress.start()
        self._task = self._progress.add_task("registering", total=1, speed="", counts="")
        return self

    def __exit__(self, *_: object) -> None:
        self._progress.stop()

    def note(self, sentence: str) -> None:
        self._console.print(sentence, highlight=False)

    def begin(self, round_number: int, total: int, done: list[str]) -> None:
        self._counts, self._moments, self._total = Counter(done), [time.monotonic()], total
        self._progress.update(
            self._task, description=f"round {round_number}", total=total, completed=len(done),
            counts=_words(self._counts), speed="",
        )  # fmt: skip

    def advance(self, row: Mapping[str, Any]) -> None:
        self._counts[row["status"]] += 1
        now = time.monotonic()
        self._moments = [*(moment for moment in self._moments if now - moment < _RATE_WINDOW), now]
        rate = (len(self._moments) - 1) / max(now - self._moments[0], 1e-6)
        left = (self._total - self._counts.total()) / rate if rate else math.inf
        self._progress.update(
            self._task, advance=1, counts=_words(self._counts),
            speed=f"{rate:.2f}/s, {_duration(left)} left" if rate else "",
        )  # fmt: skip


def _words(counts: Counter[str]) -> str:
    return ", ".join(f"{counts[status]} {status}" for status in ("ok", "doubtful", "failed"))


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}"


def _summary(items: list[dict[str, Any]], seconds: float) -> str:
    means = [
        item["s2m_mm"]["mean"] for item in items if item["s2m_mm"] and item["s2m_mm"]["mean"] is not None
    ]
    distance = f"; s2m {sum(means) / len(means):.2f} mm" if means else ""
    counts = Counter(item["status"] for item in items)
    return f"{len(items)} scans in {_duration(seconds)}: {_words(counts)}{distance}"


def _speakable(value: Any) -> Any:
    """JSON's types; infinity as a word."""
    if isinstance(value, dict):
        return {key: _speakable(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_speakable(item) for item in value]
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value
