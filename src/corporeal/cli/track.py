"""``corporeal track``: people followed through sequences of scans."""

from __future__ import annotations

import dataclasses
import json
import os
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from rich.console import Console

from corporeal.cli.commands import Track
from corporeal.cli.errors import CommandError
from corporeal.cli.files import check_output_folder, check_result, kernels_are_compiled, write_result
from corporeal.cli.named_models import named_model
from corporeal.cli.tracking_folder import (
    REPORT,
    TrackFolderError,
    check_folder,
    made_from,
    remove_results,
    waiting_lock,
)
from corporeal.cli.tracking_job import SequenceJob, TrackingSetup
from corporeal.cli.tracking_outputs import failed_outcome
from corporeal.cli.tracking_progress import SequenceBars
from corporeal.fitting.files import TrackFileError
from corporeal.fitting.options import TrackingOptions
from corporeal.model.files import ModelFileError, load_model
from corporeal.model.surface_model import SurfaceModel
from corporeal.registration.files import RegistrationFileError, load_registration
from corporeal.registration.session.cluster import DaskMissingError, run_dask
from corporeal.registration.session.files import SessionFolderError, read_json_file
from corporeal.registration.session.jobs import News, WorkerError
from corporeal.registration.session.lock import folder_lock
from corporeal.registration.session.manifest import digest
from corporeal.registration.session.model_digest import model_digest
from corporeal.registration.session.pool import run_local
from corporeal.scans.files import ScanFileError, read_sequence
from corporeal.scans.formats.sequence import ScanSequence
from corporeal.terms.model_fields import ModelParameters

Execute = Callable[[TrackingSetup, Iterable[SequenceJob]], Iterator[tuple[SequenceJob, Any]]]
STDOUT = Path("-")


def run(config: Track) -> int:
    """Track every sequence; 0 when each has its items, 1 when the only one could not be tracked.

    Raises:
        CommandError: a wrong call, results of something else in the folder, or no worker can work.
        KeyboardInterrupt: stopped; all records written so far stay.
    """
    _check_call(config)
    sequences = _sequences(config)
    setup = _setup(config)
    jobs = _jobs(config, sequences, setup)
    console = Console(stderr=True, markup=False, highlight=False, soft_wrap=True)
    if not kernels_are_compiled():
        console.print("the first run compiles kernels, for about a minute; later runs find them compiled")
    for sequence in sequences:
        for sentence in sequence.notes:
            console.print(f"{sequence.name}: {sentence}")
    outcomes = _tracked(config, setup, jobs, console)
    if config.json is not None:
        _write_result(config.json, jobs)
    lost = [outcome for outcome in outcomes if not set(outcome["statuses"]) & {"ok", "doubtful"}]
    if len(outcomes) > 1:
        total = sum((Counter(outcome["statuses"]) for outcome in outcomes), Counter[str]())
        words = ", ".join(f"{total[status]} {status}" for status in ("ok", "doubtful", "failed"))
        console.print(f"{len(outcomes)} sequences, {len(lost)} of them failed; frames: {words}")
        return 0
    return 1 if lost else 0


def _tracked(
    config: Track, setup: TrackingSetup, jobs: list[SequenceJob], console: Console
) -> list[dict[str, Any]]:
    """Run the jobs; the outcomes in their order."""
    outcomes: dict[str, dict[str, Any]] = {}
    try:
        with folder_lock(config.output):
            for job in jobs:
                _prepare(job, config.restart, console)
            with SequenceBars(console) as bars:
                for job, content in _execute(config)(setup, jobs):
                    if isinstance(content, News):
                        bars.told(job, content.content)
                    else:
                        outcomes[job.name] = content
                        bars.ended(job, content)
    except (SessionFolderError, TrackFolderError, TrackFileError, DaskMissingError) as error:
        raise CommandError(str(error), 2) from error
    except WorkerError as error:
        raise CommandError(f"{error}; what was done is kept, and the same command goes on") from error
    except OSError as error:
        where = error.filename or config.output
        raise CommandError(f"{where}: cannot be written ({error.strerror or error})") from error
    except KeyboardInterrupt:
        console.print("stopped; what was done is kept, and the same command goes on where it stopped")
        raise
    return [outcomes[job.name] for job in jobs]


def _prepare(job: SequenceJob, restart: bool, console: Console) -> None:
    """Clear the folder, or see that what it holds may be continued."""
    with waiting_lock(job.folder, lambda words: console.print(f"{job.name}: {words}")):
        if restart:
            remove_results(job.folder)
        for sentence in check_folder(job.folder, job.sequence, job.made_from):
            console.print(f"{job.name}: {sentence}")


def _execute(config: Track) -> Execute:
    workers = config.workers or os.cpu_count() or 1
    if config.dask is None:
        return partial(run_local, workers=workers, lost=_lost)
    return partial(run_dask, address=config.dask, workers=workers, lost=_lost)


def _lost(job: SequenceJob, reason: str) -> dict[str, Any]:
    return failed_outcome(job.sequence, job.folder, f"{reason}; frames that were done are kept")


def _sequences(config: Track) -> list[ScanSequence]:
    sequences = []
    for folder in config.sequences:
        try:
            sequence = read_sequence(folder)
        except ScanFileError as error:
            raise CommandError(str(error), 2) from error
        sequences.append(dataclasses.replace(sequence, frames=sequence.frames[: config.frames]))
    name, count = Counter(sequence.name for sequence in sequences).most_common(1)[0]
    if count > 1:
        raise CommandError(f"track: {count} sequences named {name!r} would write to one folder", 2)
    return sequences


def _setup(config: Track) -> TrackingSetup:
    option = "--model" if config.template is None else "--template"
    try:
        model = named_model(Path(config.model)) if config.template is None else load_model(config.template)
    except ModelFileError as error:
        raise CommandError(f"{option} {error}", 2) from error
    return TrackingSetup(model, config.template is not None, _start(config.start, model), config.meshes)


def _start(path: Path | None, model: SurfaceModel) -> ModelParameters | None:
    if path is None:
        return None
    try:
        parameters = load_registration(path).parameters
    except (RegistrationFileError, OSError) as error:
        raise CommandError(f"--start {path}: {error}", 2) from error
    if len(parameters.pose) != model.joint_count:
        raise CommandError(
            f"--start {path}: has {len(parameters.pose)} joints, the model {model.joint_count}; register the "
            "frame with the same model",
            2,
        )
    return parameters


def _jobs(config: Track, sequences: list[ScanSequence], setup: TrackingSetup) -> list[SequenceJob]:
    start = setup.known_start
    how: dict[str, Any] = {
        "model": {"name": setup.model.name, "sha256": model_digest(setup.model)},
        "template given": setup.personal,
        "start": None if start is None else digest([start.vector().tolist(), start.pose.tolist()]),
    }
    jobs, usual = [], TrackingOptions()
    for sequence in sequences:
        most = min(config.template_frames or usual.template_frames, len(sequence.frames))
        options = usual if setup.personal else dataclasses.replace(usual, template_frames=most)
        # Through JSON, so that what is read back later compares equal.
        made = json.loads(json.dumps(made_from(sequence, {**how, "options": dataclasses.asdict(options)})))
        jobs.append(SequenceJob(sequence, (config.output / sequence.name).resolve(), options, made))
    return jobs


def _write_result(path: Path, jobs: list[SequenceJob]) -> None:
    """All frames of all sequences as items, and beside them what the sequences' reports say else."""
    items, rest = [], []
    for job in jobs:
        report = read_json_file(job.folder / REPORT) or {}
        items += [{"sequence": job.name, **item} for item in report["items"]]
        rest.append({key: value for key, value in report.items() if key != "items"})
    content: Mapping[str, Any] = {"items": items, "sequences": rest}
    if path == STDOUT:
        # Written by write_json: whatever is not finite is null already.
        sys.stdout.write(json.dumps(content, indent=2) + "\n")
        return
    write_result(path, content)


def _check_call(config: Track) -> None:
    if not config.sequences:
        raise CommandError("track: name at least one folder of a sequence", 2)
    for folder in config.sequences:
        if not folder.is_dir():
            what = "is a file" if folder.exists() else "does not exist"
            raise CommandError(f"track: {folder} {what}; give the folder of a sequence", 2)
    for name in ("workers", "template_frames", "frames"):
        value = getattr(config, name)
        if value is not None and value < 1:
            raise CommandError(f"--{name.replace('_', '-')} {value}: at least one is needed", 2)
    if config.template is not None:
        if config.template_frames is not None:
            raise CommandError("--template-frames: with --template none is learned", 2)
        if config.model != Track.model:
            raise CommandError("--model: with --template the model is the template; leave one out", 2)
    if config.start is not None and len(config.sequences) > 1:
        raise CommandError("--start goes with one sequence, not with several", 2)
    check_output_folder(config.output)
    if config.json is not None and config.json != STDOUT:
        check_result(config.json)
