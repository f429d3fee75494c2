"""``corporeal evaluate``: a learned model on a held-out session, as section 5.1 of Romero et al. 2017."""

from __future__ import annotations

import dataclasses
import os
import time
from collections.abc import Mapping
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from corporeal.cli.commands import Evaluate
from corporeal.cli.errors import CommandError
from corporeal.cli.evaluation_pictures import write_evaluation_pictures
from corporeal.cli.files import check_output_folder, check_result, write_json, write_result
from corporeal.cli.learn import gathered
from corporeal.cli.named_models import named_model
from corporeal.cli.registered_session import (
    RegisteredSession,
    check_unseen,
    read_registered,
    scored_scans,
    true_scans,
)
from corporeal.cli.session_pictures import model_of
from corporeal.cli.variant_models import learned_variants
from corporeal.export.evaluation_plots import write_evaluation_plots
from corporeal.export.evaluation_tables import write_evaluation_markdown
from corporeal.learning.evaluation.held_out import HeldOut, held_out, personal_models
from corporeal.learning.evaluation.results import EvaluationResults, Summary, TruthResult
from corporeal.learning.evaluation.simulated_truth import FLEXED, against_simulation, flexed
from corporeal.learning.evaluation.study import LEARNED, LearnedVariant, Study, evaluated
from corporeal.learning.evaluation.variants import CONSTANT, planned_variants
from corporeal.learning.files import LearnedFileError, load_learned
from corporeal.learning.learned import LearnedModel
from corporeal.learning.training_set import LearningError
from corporeal.model.files import ModelFileError
from corporeal.model.surface_model import SurfaceModel

_MOST_FLEXED = 40
_LARGEST_JOINT_MM = 2.0


def run(config: Evaluate) -> int:
    """Evaluate, write tables and plots; 0 when all are written, whatever the figures say."""
    _check_call(config)
    console, begun = Console(stderr=True), time.monotonic()
    learned = _learned(config.model)
    test = read_registered(config.test, learned.model)
    check_unseen(test, config.train, learned.subjects)
    try:
        session = held_out(test.registrations, config.scored)
    except LearningError as error:
        raise CommandError(f"--test {config.test}: {error}", 2) from error
    start, asset = _start(config, learned.model), _asset(config, learned.model)
    variants, notes = _variants(config, learned, start, console)
    scans = scored_scans(test, session)
    _say(console, f"{len(scans)} scans of {len(session.hands)} hands; personal templates")
    personal = personal_models(learned.model, session)
    study = Study(learned, session, scans, personal, start, variants, asset)
    results = _fitted(study, config.workers or os.cpu_count() or 1, console)
    truth, truth_notes = _truth(study, test, session, console)
    results = dataclasses.replace(results, truth=truth, notes=(*results.notes, *notes, *truth_notes))
    _write(config, study, results, time.monotonic() - begun, console)
    return 0


def _learned(path: Path) -> LearnedModel:
    try:
        return load_learned(path)
    except (OSError, ModelFileError, LearnedFileError) as error:
        raise CommandError(f"{path}: {error}", 2) from error


def _start(config: Evaluate, model: SurfaceModel) -> SurfaceModel | None:
    """The model that learning began with, or None where nobody says which."""
    if config.start is None and not config.train:
        return None
    if config.start is not None:
        return _alike(config, "--start", config.start, model)
    try:
        start = model_of(config.train[0])
    except (OSError, ModelFileError) as error:
        raise CommandError(f"--train {config.train[0]}: {error}", 2) from error
    return _of_same_topology(config, "--start", start, model)


def _asset(config: Evaluate, model: SurfaceModel) -> SurfaceModel | None:
    """The model to compare with where it is not the start."""
    return None if config.asset is None else _alike(config, "--asset", config.asset, model)


def _alike(config: Evaluate, option: str, name: str, model: SurfaceModel) -> SurfaceModel:
    try:
        other = named_model(Path(name))
    except (OSError, ModelFileError) as error:
        raise CommandError(f"{option} {name}: {error}", 2) from error
    return _of_same_topology(config, option, other, model)


def _of_same_topology(
    config: Evaluate, option: str, other: SurfaceModel, model: SurfaceModel
) -> SurfaceModel:
    if other.template.shape != model.template.shape or other.joint_count != model.joint_count:
        raise CommandError(
            f"{option} {other.name!r}: has another template or tree than {config.model}; give one of the "
            "same mesh and joints (learning starts from the model that its registrations were made with)",
            2,
        )
    return other


def _variants(
    config: Evaluate, learned: LearnedModel, start: SurfaceModel | None, console: Console
) -> tuple[list[LearnedVariant], tuple[str, ...]]:
    """The models to compare with, and notes on what is not compared."""
    if start is None:
        return [], ("without --start or --train the learned model is not compared with its start",)
    left_out = ("not compared with models learned otherwise: that needs --train, and --variants",)
    if not config.train:
        return [], left_out
    # Also where nothing is learned: it refuses a start that the training registrations were not made with.
    training = gathered(config.train, start)
    if set(learned.names) - set(training.names):
        missing = sorted(set(learned.names) - set(training.names))
        raise CommandError(
            f"--train: {config.model} was learned from {len(missing)} scans that are not there, for instance "
            f"{missing[0]}; give all folders that it was learned from",
            2,
        )
    if not config.variants:
        return [], left_out
    planned, notes = planned_variants(training, str(start.side), learned.options)
    return learned_variants(planned, start, config.output / "models", console), notes


def _fitted(study: Study, workers: int, console: Console) -> EvaluationResults:
    columns = (
        TextColumn("fitting, {task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(),
    )  # fmt: skip
    with Progress(*columns, console=console, transient=True) as progress:
        tasks: dict[str, int] = {}

        def on_fits(protocol: str, done: int, count: int) -> None:
            if protocol not in tasks:
                tasks[protocol] = progress.add_task(protocol, total=count)
            progress.update(tasks[protocol], completed=done)  # type: ignore[arg-type]

        return evaluated(study, workers, on_fits)


def _truth(
    study: Study, test: RegisteredSession, session: HeldOut, console: Console
) -> tuple[tuple[TruthResult, ...], tuple[str, ...]]:
    """Models with correctives against the truth of the simulation, and notes."""
    scans = (
        flexed(true_scans(test, session.hands), _MOST_FLEXED) if study.learned.model.side == "right" else ()
    )
    if not scans or test.simulation is None:
        return (), ("no truth: the session is not simulated, its truth/ is not there, or no hand is flexed",)
    _say(console, f"truth of {len(scans)} flexed scans")
    compared = {LEARNED: (study.learned.model, study.personal)}
    for entry in study.variants:
        if entry.variant.label == CONSTANT:
            compared[CONSTANT] = (entry.learned.model, personal_models(entry.learned.model, session))
    found, notes = [], []
    for label, (model, personal) in compared.items():
        if not model.has_correctives:
            continue
        templates: Mapping = {hand: own.template for hand, own in personal.items()}
        result = against_simulation(label, model, templates, scans, test.simulation)
        found.append(result)
        if result.joint_error is not None:
            notes.append(_joint_note(label, result.joint_error))
    notes.append(
        f"truth: accepted scans of any pose with the fingers bent by more than {FLEXED:g} degrees in the "
        "mean; true pose and true template are given, nothing is fitted"
    )
    return tuple(found), tuple(notes)


def _joint_note(label: str, error: Summary) -> str:
    met = "met" if error.mean <= _LARGEST_JOINT_MM else "not met"
    return (
        f"{label}, joint centres at true templates: {error.mean:.2f} mm in the mean, 95 % under "
        f"{error.p95:.2f} mm; {_LARGEST_JOINT_MM:g} mm in the mean asked for: {met}"
    )


def _write(
    config: Evaluate, study: Study, results: EvaluationResults, seconds: float, console: Console
) -> None:
    content = results.to_json()
    try:
        config.output.mkdir(parents=True, exist_ok=True)
        write_json(config.output / "evaluation.json", content)
        title = f"{config.model.stem} on {config.test.name}"
        write_evaluation_markdown(config.output / "evaluation.md", content, title)
        plots = write_evaluation_plots(config.output, content)
        write_evaluation_pictures(
            config.output, study.learned.model, study.personal, study.scans, study.variants
        )
    except OSError as error:
        raise CommandError(f"-o {config.output}: cannot be written: {error.strerror or error}") from error
    for line in plots.left_out:
        _say(console, line)
    if config.json is not None:
        write_result(config.json, content | {"seconds": seconds})
    for line in _key_lines(results):
        print(line)
    _say(console, f"{config.output}: {seconds:.0f} s")


def _key_lines(results: EvaluationResults) -> list[str]:
    """The figures that the issue asks for, each with its protocol."""
    lines = [
        f"{curve.label}, {curve.protocol}: {curve.full.mean:.3f} mm over {curve.n_scans} scans"
        for curve in results.pose_generalisation
    ]
    for ratio in results.ratios:
        interval = "" if ratio.interval is None else f" ({ratio.interval[0]:.3f} to {ratio.interval[1]:.3f})"
        limit = "" if ratio.limit is None else f", limit {ratio.limit:g}: {'met' if ratio.met else 'not met'}"
        paper = "" if ratio.paper is None else f", paper {ratio.paper:g}"
        lines.append(f"{ratio.name}, {ratio.protocol}: {ratio.value:.3f}{interval}{paper}{limit}")
    lines += [
        f"{result.label}, R² against the truth: {result.r_squared:.3f} over {result.n_scans} scans"
        for result in results.truth
    ]
    return lines + list(results.notes)


def _check_call(config: Evaluate) -> None:
    check_output_folder(config.output)
    if config.workers is not None and config.workers < 1:
        raise CommandError(f"--workers: expected at least 1, got {config.workers}", 2)
    if config.json is not None:
        check_result(config.json)


def _say(console: Console, line: str) -> None:
    console.print(line, highlight=False, soft_wrap=True, markup=False)
