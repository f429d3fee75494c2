"""Models that ``corporeal evaluate`` learns to compare with; kept, so that it can go on when interrupted."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from corporeal.cli.errors import CommandError
from corporeal.cli.learn import learned_from
from corporeal.learning.evaluation.study import LearnedVariant
from corporeal.learning.evaluation.variants import Variant
from corporeal.learning.files import LearnedFileError, load_learned, save_learned
from corporeal.learning.learned import LearnedModel
from corporeal.model.files import ModelFileError
from corporeal.model.surface_model import SurfaceModel
from corporeal.registration.session.model_digest import model_digest

_NOTE = "learned for an evaluation from"


def learned_variants(
    variants: Sequence[Variant], start: SurfaceModel, folder: Path, console: Console
) -> list[LearnedVariant]:
    """Learn every variant, or read it where it was learned before from the same data with the same options.

    Args:
        variants: what is to be learned.
        start: where learning begins.
        folder: that the models are kept in.
        console: that is told.

    Raises:
        CommandError: nothing can be learned from a variant's data, or a model cannot be written.
    """
    begin = model_digest(start)
    found = []
    for number, variant in enumerate(variants, start=1):
        path = folder / f"{variant.label.replace(', ', '-').replace(' ', '-')}.npz"
        digest = variant.digest(begin)
        learned = _kept(path, digest)
        _say(console, f"{variant.label} ({number} of {len(variants)}): {'kept' if learned else 'learning'}")
        if learned is None:
            learned = learned_from(variant.training, start, variant.options, console)
            notes = dict(learned.model.notes) | {_NOTE: digest}
            model = learned.model.replace(name=variant.label.replace(" ", "_"), notes=notes)
            learned = dataclasses.replace(learned, model=model)
            try:
                save_learned(learned, path)
            except (OSError, ModelFileError) as error:
                raise CommandError(f"{path}: cannot be written: {error}") from error
        found.append(LearnedVariant(variant, learned))
    return found


def _kept(path: Path, digest: str) -> LearnedModel | None:
    """The model in a file, unless it was learned from other data or cannot be read."""
    try:
        learned = load_learned(path)
    except (OSError, ModelFileError, LearnedFileError):
        return None
    return learned if learned.model.notes.get(_NOTE) == digest else None


def _say(console: Console, line: str) -> None:
    console.print(line, highlight=False, soft_wrap=True, markup=False)
