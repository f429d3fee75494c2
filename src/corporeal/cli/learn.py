"""``corporeal learn``: registered sessions -> a model file."""

from __future__ import annotations

import dataclasses
import functools
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

import corporeal
from corporeal.cli.commands import Learn
from corporeal.cli.errors import CommandError
from corporeal.cli.files import check_output_folder, check_result, write_result
from corporeal.cli.learned_pictures import write_pictures
from corporeal.cli.registered_session import start_of
from corporeal.learning.files import LearnedFileError, companion_path, load_learned, save_learned
from corporeal.learning.learn import learn_model
from corporeal.learning.learned import LearnedModel, StepLog
from corporeal.learning.options import LearningOptions
from corporeal.learning.training_set import LearningError, TrainingSet, training_set
from corporeal.model.files import ModelFileError
from corporeal.model.surface_model import SurfaceModel
from corporeal.registration.session.files import (
    MANIFEST,
    SessionFolderError,
    read_decisions,
    read_json_file,
    read_records,
)
from corporeal.registration.session.model_digest import model_digest
from corporeal.registration.session.records import RecordError


@dataclass(frozen=True)
class LearnCall:
    """What to learn, and where to.

    Attributes:
        output: the model file.
        options: of learning.
        name: of the model; the start's name where it is None.
        sources: names of what was registered, for the model's notes.
    """

    output: Path
    options: LearningOptions
    name: str | None = None
    sources: tuple[str, ...] = ()


def run(config: Learn) -> int:
    """Learn, write the model and what it was learned with; 0 when both are written."""
    _check_call(config)
    console = Console(stderr=True)
    start = start_of(config.start, config.registrations[0])
    training = gathered(config.registrations, start)
    if config.sides == "right-only":
        training = _of_side(training, "right")
    options = _options(config)
    sources = tuple(folder.name for folder in config.registrations)
    result = learn_file(training, start, LearnCall(config.output, options, config.name, sources), console)
    if config.pictures:
        draw_model(config.output, console)
    if config.json is not None:
        write_result(config.json, result)
    return 0


def _options(config: Learn) -> LearningOptions:
    options = LearningOptions(
        correctives=config.correctives,
        regularisation=config.regularisation,
        corrective_strength=config.corrective_strength,
        neutral_first=config.neutral_first,
        start_shape_weight=config.start_shape_weight,
        seed=config.seed,
    )
    return options if config.hinges else dataclasses.replace(options, hinge_strength=0.0)


def learn_file(
    training: TrainingSet, start: SurfaceModel, call: LearnCall, console: Console
) -> dict[str, Any]:
    """Learn, and write the model with its companion; returns what ``--json`` says.

    Raises:
        CommandError: nothing can be learned, or a file cannot be written.
    """
    begun = time.monotonic()
    learned = learned_from(training, start, call.options, console)
    model = described(learned, start, call)
    learned = dataclasses.replace(learned, model=model)
    try:
        save_learned(learned, call.output)
    except (OSError, ModelFileError) as error:
        raise CommandError(f"{call.output}: cannot be written: {error}") from error
    seconds = time.monotonic() - begun
    console.print(_summary(learned, call.output, seconds), highlight=False, soft_wrap=True, markup=False)
    return result_of(learned, seconds)


def draw_model(path: Path, console: Console) -> None:
    """Pictures of a learned model and its GLB, beside its file.

    Raises:
        CommandError: the model cannot be read, or a file cannot be written.
    """
    try:
        written = write_pictures(load_learned(path), path)
    except (OSError, ModelFileError, LearnedFileError) as error:
        raise CommandError(f"--pictures: {error}") from error
    names = ", ".join(str(file) for file in written)
    console.print(f"pictures: {names}", highlight=False, soft_wrap=True, markup=False)


def gathered(folders: Sequence[Path], start: SurfaceModel) -> TrainingSet:
    """The accepted registrations of all folders, one or more.

    People of the same name in two folders are one person only where the folders register one session.

    Raises:
        CommandError: a folder cannot be read, or was registered with another model than the start.
    """
    sets = []
    try:
        for folder in folders:
            manifest = read_json_file(folder / MANIFEST) or {}
            _check_model(folder, manifest, start)
            sets.append(training_set(read_records(folder), start, read_decisions(folder)))
    except (RecordError, SessionFolderError, LearningError) as error:
        raise CommandError(str(error), 2) from error
    return functools.reduce(TrainingSet.joined, sets)


def learned_from(
    training: TrainingSet, start: SurfaceModel, options: LearningOptions, console: Console
) -> LearnedModel:
    """Learn with a line per sweep on the console.

    Raises:
        CommandError: nothing can be learned from this.
    """
    people = len(set(training.subjects))
    console.print(
        f"{len(training)} registrations of {len(set(training.hands))} hands of {people} people",
        highlight=False, soft_wrap=True,
    )  # fmt: skip
    last: list[StepLog] = []

    def on_step(step: StepLog) -> None:
        if last and step.sweep != last[-1].sweep:
            _say(console, last[-1])
        last.append(step)

    try:
        learned = learn_model(training, start, options, on_step)
    except LearningError as error:
        raise CommandError(str(error)) from error
    _say(console, learned.log[-1])
    if learned.left_out:
        console.print(
            f"left out, because the model cannot explain them: {', '.join(learned.left_out)}",
            highlight=False, soft_wrap=True,
        )  # fmt: skip
    return learned


def described(learned: LearnedModel, start: SurfaceModel, call: LearnCall) -> SurfaceModel:
    """The model with its name and where it comes from."""
    notes = dict(start.notes) | {
        "builder": "corporeal learn",
        "learned": f"corporeal {corporeal.__version__} learn, from {len(learned.names)} registrations of "
        f"{len(learned.hands)} hands of {len(set(learned.subjects))} people",
        "learned from": ", ".join(call.sources),
        "correctives": "learned from registrations" if learned.model.has_correctives else "none",
        "pose statistics": "of the registrations",
        "shape space": _shape_words(call.options.start_shape_weight),
        "limits": "those of the start model",
    }
    return learned.model.replace(name=call.name or start.name, notes=notes)


def _shape_words(start_weight: float) -> str:
    if start_weight == 0:
        return "of the personal templates"
    return (
        f"covariance of the personal templates plus, across its first component, {start_weight:g} times the "
        "start model's"
    )


def result_of(learned: LearnedModel, seconds: float) -> dict[str, Any]:
    """The machine-readable result."""
    return {
        "registrations": len(learned.names),
        "hands": len(learned.hands),
        "subjects": len(set(learned.subjects)),
        "left_out": list(learned.left_out),
        "rms_mm": float(learned.log[-1].rms_mm),
        "seconds": seconds,
        "log": [dataclasses.asdict(step) for step in learned.log],
    }


def _say(console: Console, step: StepLog) -> None:
    console.print(
        f"sweep {step.sweep}: {step.rms_mm:.3f} mm from {step.registrations} registrations, objective "
        f"{1e3 * step.objective:.4g}",
        highlight=False, soft_wrap=True,
    )  # fmt: skip


def _of_side(training: TrainingSet, side: str) -> TrainingSet:
    import numpy as np

    return training.subset(np.array([hand.endswith(f"/{side}") for hand in training.hands]))


def _check_model(folder: Path, manifest: Mapping[str, Any], start: SurfaceModel) -> None:
    named = manifest.get("model", {})
    if isinstance(named, dict) and named.get("sha256") not in (None, model_digest(start)):
        raise CommandError(
            f"{folder}: was registered with another model ({named.get('name')!r}) than the start "
            f"{start.name!r}; give the file of that model with --start",
            2,
        )


def _check_call(config: Learn) -> None:
    if not config.registrations:
        raise CommandError("REG: give at least one folder that corporeal register wrote to", 2)
    if config.output.suffix != ".npz":
        raise CommandError(f"-o {config.output}: name a file that ends in .npz", 2)
    check_output_folder(config.output.parent)
    if config.output.is_dir() or companion_path(config.output).is_dir():
        raise CommandError(f"-o {config.output}: is a folder; name a file", 2)
    if not 0 <= config.start_shape_weight < math.inf:
        raise CommandError(f"--start-shape-weight {config.start_shape_weight}: expected 0 or more", 2)
    if not 0 < config.corrective_strength < math.inf:
        raise CommandError(f"--corrective-strength {config.corrective_strength}: expected more than 0", 2)
    if config.json is not None:
        check_result(config.json)


def _summary(learned: LearnedModel, output: Path, seconds: float) -> str:
    return (
        f"{output}: {learned.model.vertex_count} vertices, {learned.model.shape_count} shape directions; "
        f"{learned.log[-1].rms_mm:.2f} mm from {len(learned.names)} registrations; {seconds:.0f} s"
    )
