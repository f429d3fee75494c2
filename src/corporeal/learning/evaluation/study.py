"""The study of section 5.1 of Romero et al. 2017: what is compared, by which protocol, and the ratios."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from corporeal.learning.evaluation.bootstrap import learning_curve_point, ratio_of_curves
from corporeal.learning.evaluation.compactness import compactness
from corporeal.learning.evaluation.held_out import HeldOut, personal_models
from corporeal.learning.evaluation.locality import feature_moments, locality
from corporeal.learning.evaluation.pose_generalisation import (
    ComparedModel,
    HeldOutScan,
    pose_generalisation,
)
from corporeal.learning.evaluation.protocols import PoseAndShape, PoseOnly
from corporeal.learning.evaluation.results import (
    CompactnessCurve,
    EvaluationResults,
    LearningCurvePoint,
    Locality,
    PoseCurve,
    Protocol,
    Ratio,
    ShapeCurve,
)
from corporeal.learning.evaluation.shape_generalisation import shape_generalisation
from corporeal.learning.evaluation.variants import (
    CONSTANT,
    MIRRORED,
    ONE_SIDED,
    WITHOUT_CORRECTIVES,
    WITHOUT_NEUTRAL_FIRST,
    Variant,
)
from corporeal.learning.joint_distances import geodesic_joint_distances
from corporeal.learning.learned import LearnedModel
from corporeal.learning.start_model import crude_start
from corporeal.model.surface_model import SurfaceModel

LEARNED, OFF = "learned", "learned, correctives off"
ASSET, CRUDE, START = "asset start", "crude start", "start"
LARGEST_S2M = 0.6
"""Millimetres: of the learned model, pose only, with the full pose."""
_POSE_COMPONENTS = (1, 2, 3, 6, 10, 15, 20, 30, 45)
_FEW_COMPONENTS = (6, 15)
_SHAPE_COMPONENTS = (0, 1, 2, 3, 4, 5, 6, 8, 10, 15, 20, 25, 30)
_FEWEST_SUBJECTS = 3
_POSE_ONLY, _FREE = PoseOnly().name, PoseAndShape().name
OnFits = Callable[[str, int, int], None]


@dataclass(frozen=True)
class _AskedRatio:
    name: str
    numerator: str
    denominator: str
    protocol: Protocol
    paper: float | None = None
    limit: float | None = None


# Limits: a model is worth learning where it beats these; figures of the paper beside them.
_RATIOS = (
    _AskedRatio("correctives on / off", LEARNED, OFF, _POSE_ONLY, 0.72, 0.72),
    _AskedRatio("learned with / without correctives", LEARNED, WITHOUT_CORRECTIVES, _POSE_ONLY, None, 1.0),
    _AskedRatio("geodesic / constant regularisation", LEARNED, CONSTANT, _POSE_ONLY),
    _AskedRatio("equation 11 on / off", LEARNED, WITHOUT_NEUTRAL_FIRST, _POSE_ONLY),
    _AskedRatio("mirrored / right only", MIRRORED, ONE_SIDED, _POSE_ONLY, 0.886, 1.0),
    _AskedRatio("learned / crude start", LEARNED, CRUDE, _FREE, 0.35, 0.35),
    _AskedRatio("learned / asset start", LEARNED, ASSET, _FREE, None, 0.8),
    _AskedRatio("learned / start", LEARNED, START, _FREE),
)


@dataclass(frozen=True, eq=False)
class LearnedVariant:
    """A variant and what was learned."""

    variant: Variant
    learned: LearnedModel


@dataclass(frozen=True, eq=False)
class Study:
    """What is compared on what.

    Attributes:
        learned: the model that is evaluated.
        session: the held-out session.
        scans: of its scored registrations.
        personal: hand -> the learned model around the hand's own template.
        start: the model that learning began with; None leaves the comparison with it out.
        variants: models learned otherwise.
        asset: a model from which nothing was learned, where learning began with a better one.
    """

    learned: LearnedModel
    session: HeldOut
    scans: Sequence[HeldOutScan]
    personal: Mapping[str, SurfaceModel]
    start: SurfaceModel | None
    variants: Sequence[LearnedVariant] = ()
    asset: SurfaceModel | None = None


def evaluated(study: Study, workers: int, on_fits: OnFits | None = None) -> EvaluationResults:
    """All that is measured on held-out scans and on the learned model itself; the notes are the session's.

    Args:
        study: what is compared.
        workers: processes.
        on_fits: told of a protocol how many fits are done, and how many there are.

    Raises:
        ValueError: models that do not fit to the scans' registrations.
    """

    def curves_of(compared: Sequence[ComparedModel], protocol: Protocol) -> tuple[PoseCurve, ...]:
        def on_scan(done: int, count: int) -> None:
            if on_fits is not None:
                on_fits(protocol, done, count)

        return pose_generalisation(compared, study.scans, workers, on_scan)

    fixed = tuple(
        replace(curve, limit=LARGEST_S2M) if curve.label == LEARNED else curve
        for curve in curves_of(pose_only(study), _POSE_ONLY)
    )
    free = curves_of(pose_and_shape_free(study), _FREE)
    points = {entry.variant.label: entry.variant for entry in study.variants if entry.variant.learning_curve}
    shape, shape_notes = _shape_curves(study.learned)
    ratios, ratio_notes = compared_curves((*fixed, *free))
    return EvaluationResults(
        compactness=_compactness(study.learned),
        pose_generalisation=(*fixed, *free),
        shape_generalisation=shape,
        ratios=ratios,
        locality=localities(study),
        learning_curve=_learning_curve(fixed, points),
        notes=(*study.session.notes, *_curve_notes((*fixed, *free)), *shape_notes, *ratio_notes),
    )


def pose_only(study: Study) -> list[ComparedModel]:
    """The learned model, correctives on and off, and every variant around personal templates of its own."""
    components = _available(study.learned.model, _POSE_COMPONENTS)
    compared = [ComparedModel(LEARNED, study.personal, PoseOnly(), components)]
    if study.learned.model.has_correctives:
        compared.append(ComparedModel(OFF, study.personal, PoseOnly(), correctives=False))
    for entry in study.variants:
        models = personal_models(entry.learned.model, study.session)
        few = _FEW_COMPONENTS if entry.variant.label in (MIRRORED, ONE_SIDED) else ()
        compared.append(
            ComparedModel(entry.variant.label, models, PoseOnly(), _available(entry.learned.model, few))
        )
    return compared


def pose_and_shape_free(study: Study) -> list[ComparedModel]:
    """The learned model, the asset and a crude start; the start too, where it is another than the asset.

    The crude one is made of the asset: joints that scans have placed would make it less crude.
    """
    models = {LEARNED: study.learned.model}
    if study.start is not None:
        asset = study.asset or study.start
        models |= {ASSET: asset, CRUDE: crude_start(asset)}
    if study.start is not None and study.asset is not None:
        models[START] = study.start
    return [
        ComparedModel(
            label,
            dict.fromkeys(study.session.hands, model),
            PoseAndShape(),
            _available(model, _FEW_COMPONENTS),
        )
        for label, model in models.items()
    ]


def compared_curves(curves: Iterable[PoseCurve]) -> tuple[tuple[Ratio, ...], tuple[str, ...]]:
    """The ratios whose two curves are there, and notes on those that no scan allows."""
    by_name = {(curve.label, curve.protocol): curve for curve in curves}
    ratios, notes = [], []
    for asked in _RATIOS:
        above = by_name.get((asked.numerator, asked.protocol))
        below = by_name.get((asked.denominator, asked.protocol))
        if above is None or below is None:
            continue
        try:
            ratios.append(ratio_of_curves(asked.name, above, below, paper=asked.paper, limit=asked.limit))
        except ValueError as error:
            notes.append(f"no ratio: {error}")
    return tuple(ratios), tuple(notes)


def localities(study: Study) -> tuple[Locality, ...]:
    """How local the correctives of the learned model and of the one regularised by a constant are.

    Distances are those of the learned template for both: the same vertices count as far.
    """
    model = study.learned.model
    compared = {LEARNED: study.learned}
    compared |= {e.variant.label: e.learned for e in study.variants if e.variant.label == CONSTANT}
    distances = geodesic_joint_distances(model.template, model.faces, model.joint_regressor)
    found = []
    for label, learned in compared.items():
        directions = learned.model.pose_directions
        if not learned.model.has_correctives or not np.any(directions):
            continue
        found.append(locality(label, directions, distances, model.joint_names))
        moments = feature_moments(learned.poses)
        found.append(locality(label, directions, distances, model.joint_names, moments=moments))
    return tuple(found)


def _available(model: SurfaceModel, components: Sequence[int]) -> tuple[int, ...]:
    most = max((len(block.components) for block in model.pose_blocks), default=0)
    return tuple(count for count in components if count <= most)


def _compactness(learned: LearnedModel) -> tuple[CompactnessCurve, ...]:
    return (
        compactness(LEARNED, "pose", _descending(learned.pose_variances)),
        compactness(LEARNED, "shape", _descending(learned.shape_variances)),
    )


def _descending(variances: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Principal variances; the last ones are zero but for rounding, and in no order."""
    return np.sort(np.maximum(variances, 0))[::-1]


def _shape_curves(learned: LearnedModel) -> tuple[tuple[ShapeCurve, ...], tuple[str, ...]]:
    people = len(set(learned.subjects))
    if people < _FEWEST_SUBJECTS:
        return (), (f"no generalisation of shape: {people} subjects, {_FEWEST_SUBJECTS} are needed",)
    most = len(learned.hands) - max(learned.subjects.count(person) for person in learned.subjects) - 1
    components = [count for count in _SHAPE_COMPONENTS if count <= most]
    curve = shape_generalisation(LEARNED, learned.templates, learned.hands, learned.subjects, components)
    return (curve,), ()


def _learning_curve(
    curves: Sequence[PoseCurve], variants: Mapping[str, Variant]
) -> tuple[LearningCurvePoint, ...]:
    return tuple(
        learning_curve_point(variants[curve.label].learning_curve, curve, len(variants[curve.label].training))
        for curve in curves
        if curve.label in variants
    )


def _curve_notes(curves: Sequence[PoseCurve]) -> list[str]:
    notes = []
    for curve in curves:
        failed = [scan.name for scan in curve.scans if scan.status != "ok"]
        if failed:
            notes.append(
                f"{curve.label}, {curve.protocol}: not fitted and not in the means: {', '.join(failed)}"
            )
        if curve.label != LEARNED:
            continue
        values = (*curve.mean, curve.full.mean)
        rises = sum(after > before for before, after in pairwise(values))
        if len(values) > 1:
            falls = "falls with every step" if not rises else f"rises at {rises} of {len(values) - 1} steps"
            notes.append(f"learned, {curve.protocol}: the mean error {falls} from {curve.components} to full")
        if curve.limit is not None:
            met = "met" if curve.full.mean <= curve.limit else "not met"
            notes.append(
                f"learned, {curve.protocol}, full pose space: {curve.full.mean:.3f} mm from scan to model, "
                f"at most {curve.limit:g} mm asked for: {met}"
            )
    return notes
