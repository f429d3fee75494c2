"""Models learned otherwise, to compare with: without correctives, from other or from fewer registrations."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Int

import corporeal
from corporeal.learning.options import LearningOptions
from corporeal.learning.training_set import TrainingSet

A_SIDE = 777
"""Registrations of a side in the paper, about."""
MIRRORED, ONE_SIDED = "mirrored", "right only"
WITHOUT_CORRECTIVES = "learned without correctives"
CONSTANT = "constant regularisation"
WITHOUT_NEUTRAL_FIRST = "learned without equation 11"
_MIRRORED_COUNTS = (250, 500, 1000)
_ONE_SIDED_COUNTS = (250, 500)


@dataclass(frozen=True, eq=False)
class Variant:
    """A model to be learned.

    Attributes:
        label: of its curve.
        training: what it is learned from.
        options: how.
        learning_curve: which learning curve it is a point of, or "".
    """

    label: str
    training: TrainingSet
    options: LearningOptions
    learning_curve: str = ""

    def digest(self, start_digest: str) -> str:
        """SHA-256 of all that the learned model depends on."""
        content = hashlib.sha256(f"corporeal {corporeal.__version__} {start_digest}".encode())
        for name in ("vertices", "poses", "translations", "shapes"):
            content.update(np.ascontiguousarray(getattr(self.training, name)).tobytes())
        words = [self.training.hands, self.training.names, dataclasses.asdict(self.options)]
        content.update(json.dumps(words, sort_keys=True).encode())
        return content.hexdigest()


def planned_variants(
    training: TrainingSet, side: str, options: LearningOptions | None = None, seed: int = 0
) -> tuple[tuple[Variant, ...], tuple[str, ...]]:
    """All variants that the training set allows, and what it does not allow.

    Smaller sets lie within larger ones, and one-sided sets within mirrored ones of twice their size: two
    models differ by what was added, and not by what was drawn. Counts beyond the set's are left out.

    Args:
        training: the whole training set.
        side: of the model: the other one's registrations came in mirrored.
        options: of the model that is evaluated.
        seed: of the draws.
    """
    options = options or LearningOptions()
    variants = [
        Variant(WITHOUT_CORRECTIVES, training, dataclasses.replace(options, correctives=False)),
        Variant(CONSTANT, training, dataclasses.replace(options, regularisation="constant")),
        Variant(WITHOUT_NEUTRAL_FIRST, training, dataclasses.replace(options, neutral_first=False)),
    ]
    own = np.array([hand.endswith(f"/{side}") for hand in training.hands])
    orders = [drawn_evenly(training.subjects, np.flatnonzero(part), seed) for part in (own, ~own)]
    if not len(orders[0]) or not len(orders[1]):
        return tuple(variants), ("mirrored against right only: needs training registrations of both sides",)
    notes = []
    size = min(A_SIDE, *map(len, orders))
    if size < A_SIDE:
        notes.append(f"mirrored against right only: {size} registrations a side, the paper has {A_SIDE}")
    for count in (*(count for count in _ONE_SIDED_COUNTS if count < size), size):
        label = ONE_SIDED if count == size else f"{ONE_SIDED}, {count}"
        chosen = np.sort(orders[0][:count])
        variants.append(Variant(label, training.subset(chosen), options, ONE_SIDED))
    for count in (*(count for count in _MIRRORED_COUNTS if count < 2 * size), 2 * size):
        label = MIRRORED if count == 2 * size else f"{MIRRORED}, {count}"
        chosen = np.sort(np.concatenate([order[: count // 2] for order in orders]))
        variants.append(Variant(label, training.subset(chosen), options, MIRRORED))
    return tuple(variants), tuple(notes)


def drawn_evenly(subjects: Sequence[str], among: Int[np.ndarray, " n"], seed: int) -> Int[np.ndarray, " n"]:
    """Indices in random order, one of each subject after the other: every beginning keeps all subjects."""
    generator = np.random.default_rng(seed)
    shuffled = generator.permutation(among)
    turns: dict[str, int] = {}
    keys = []
    for index in shuffled:
        turn = turns.get(subjects[index], 0)
        turns[subjects[index]] = turn + 1
        keys.append(turn)
    return shuffled[np.argsort(np.array(keys, dtype=np.int64), kind="stable")]
