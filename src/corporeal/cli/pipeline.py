"""``corporeal pipeline``: a capture session -> registrations -> a model, as many rounds as asked."""

from __future__ import annotations

import dataclasses
import os
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

import corporeal
from corporeal.atomic import write_bytes
from corporeal.cli import simulate
from corporeal.cli.commands import Pipeline, Simulate
from corporeal.cli.errors import CommandError
from corporeal.cli.files import check_output_folder, check_result, write_result
from corporeal.cli.learn import LearnCall, draw_model, gathered, learn_file
from corporeal.cli.registered_session import start_of
from corporeal.cli.session import SessionCall, run_session
from corporeal.learning.files import companion_path
from corporeal.learning.options import LearningOptions
from corporeal.learning.training_set import TrainingSet
from corporeal.model.files import ModelFileError, load_model
from corporeal.model.surface_model import SurfaceModel
from corporeal.registration.session.files import (
    DECISIONS,
    ITEMS,
    MANIFEST,
    SessionFolderError,
    read_json_file,
    record_path,
    sha256_of,
    write_json_file,
)
from corporeal.registration.session.manifest import digest
from corporeal.registration.session.model_digest import model_digest

_MODEL = "model.npz"


@dataclass(frozen=True)
class Round:
    """Where one round's results lie.

    Attributes:
        number: from 1.
        folder: of the round.
    """

    number: int
    folder: Path

    @property
    def registrations(self) -> Path:
        """What registering writes to."""
        return self.folder / "registrations"

    @property
    def model(self) -> Path:
        """What learning writes."""
        return self.folder / _MODEL

    @property
    def state(self) -> Path:
        """What the model was learned from."""
        return self.folder / "state.json"


def run(config: Pipeline) -> int:
    """Do what is missing; 0 when the model of the last round is there, or it is the curator's turn."""
    _check_call(config)
    console = Console(stderr=True, markup=False, highlight=False, soft_wrap=True)
    model = start_of(config.start, config.output)
    if config.simulate:
        workers = config.workers or 0
        simulate.run(Simulate(config.session, config.subjects, config.poses, config.seed, workers=workers))
    rounds = [Round(number, config.output / f"round-{number}") for number in range(1, 1 + config.rounds)]
    items: list[dict[str, Any]] = []
    try:
        for before, now in zip([None, *rounds[:-1]], rounds, strict=True):
            console.print(f"round {now.number}: registering with {model.name} into {now.registrations}")
            run_session(_registering(config, before, now, model, console), model)
            items.append({"round": now.number, "statuses": _statuses(now)})
            if config.wait_for_curation and not (now.registrations / DECISIONS).exists():
                without = ", without --restart" if config.restart else ""
                console.print(f"round {now.number}: curate it, then give the same command again{without}:")
                print(f"corporeal curate {now.registrations}", flush=True)
                return _told(config, items, None)
            items[-1] |= _learned(config, now, model, console)
            model = load_model(now.model)
        output = _published(rounds[-1], config.output)
    except (SessionFolderError, ModelFileError) as error:
        raise CommandError(str(error), 2) from error
    except OSError as error:
        where = error.filename or config.output
        raise CommandError(f"{where}: cannot be written ({error.strerror or error})") from error
    console.print(f"{output}: the model of round {config.rounds}")
    if config.pictures:
        draw_model(output, console)
    return _told(config, items, output)


def _registering(
    config: Pipeline, before: Round | None, now: Round, model: SurfaceModel, console: Console
) -> SessionCall:
    """The round's call of ``corporeal register``; registrations with an older model of ours are redone."""
    restart = config.restart
    if before is not None and not restart:
        manifest = read_json_file(now.registrations / MANIFEST)
        if manifest is not None and manifest["model"]["sha256"] != model_digest(model):
            console.print(
                f"round {now.number}: was registered with another model than round {before.number} has now; "
                "it is registered again"
            )
            restart = True
    return SessionCall(
        folder=config.session,
        output=now.registrations,
        workers=config.workers or os.cpu_count() or 1,
        restart=restart,
        landmarks_from=None if before is None else before.registrations,
    )


def _learned(config: Pipeline, now: Round, start: SurfaceModel, console: Console) -> dict[str, Any]:
    """Learn the round's model, unless it is there and was learned from the same; returns its result."""
    training = gathered([now.registrations], start)
    options = LearningOptions(seed=config.seed)
    call = LearnCall(now.model, options, config.name, (config.session.resolve().name,))
    inputs = _inputs(now, training, start, call)
    kept = read_json_file(now.state)
    reason = _why_anew(kept, inputs, now)
    if kept is not None and reason is None:
        console.print(f"round {now.number}: {now.model} was learned from the same; it is kept")
        return dict(kept["result"])
    if now.model.exists():
        console.print(f"round {now.number}: {reason}; it is learned anew")
    result = learn_file(training, start, call, console)
    write_json_file(now.state, {"inputs": inputs, "files": _hashes(now), "result": result})
    return result


def _inputs(now: Round, training: TrainingSet, start: SurfaceModel, call: LearnCall) -> dict[str, Any]:
    """All that the model follows from; the curator's decisions show in which registrations are accepted."""
    records = {name: sha256_of(record_path(now.registrations, name)) for name in training.names}
    return {
        "accepted registrations": digest(records),
        "start model": model_digest(start),
        "options of learning": digest(dataclasses.asdict(call.options)),
        "name": call.name,
        "session": list(call.sources),
        "version of corporeal": corporeal.__version__,
    }


def _why_anew(kept: Mapping[str, Any] | None, inputs: Mapping[str, Any], now: Round) -> str | None:
    """Why the model that is there is not what would be learned now, or None."""
    if kept is None:
        return f"it is not known what {now.model} was learned from"
    changed = [name for name, value in inputs.items() if kept.get("inputs", {}).get(name) != value]
    if changed:
        return f"since {now.model} was learned, this has changed: {', '.join(changed)}"
    if kept.get("files") != _hashes(now):
        return f"{now.model} or what lies beside it is not what was learned"
    return None


def _hashes(now: Round) -> dict[str, str | None]:
    return {path.name: sha256_of(path) for path in (now.model, companion_path(now.model))}


def _published(last: Round, output: Path) -> Path:
    """Copy the last round's model out; its companion first, so that a model file is never alone."""
    target = output / _MODEL
    write_bytes(companion_path(target), companion_path(last.model).read_bytes())
    write_bytes(target, last.model.read_bytes())
    return target


def _statuses(now: Round) -> dict[str, int]:
    items = (read_json_file(now.registrations / ITEMS) or {}).get("items", [])
    return dict(Counter(str(item["status"]) for item in items))


def _told(config: Pipeline, items: list[dict[str, Any]], output: Path | None) -> int:
    if config.json is not None:
        write_result(config.json, {"rounds": items, "model": None if output is None else str(output)})
    return 0


def _check_call(config: Pipeline) -> None:
    if config.rounds < 1:
        raise CommandError(f"--rounds {config.rounds}: at least one is needed", 2)
    if config.workers is not None and config.workers < 1:
        raise CommandError(f"--workers {config.workers}: at least one is needed", 2)
    if not config.simulate and (config.subjects, config.poses) != (Pipeline.subjects, Pipeline.poses):
        raise CommandError("--subjects and --poses go with --simulate, not with a session that is there", 2)
    check_output_folder(config.output)
    if config.json is not None:
        check_result(config.json)
