"""One scan, from landmarks or from nothing, to a registration."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from weakref import WeakKeyDictionary

import numpy as np
from jaxtyping import Float

from corporeal.model.mirror import mirror_model
from corporeal.model.surface_model import Side, SurfaceModel
from corporeal.registration.evidence import LandmarkEvidence
from corporeal.registration.hand_starts import HandTried, hand_landmarks, hands_tried
from corporeal.registration.judgement import verdict_of
from corporeal.registration.limbs import limbs_tried
from corporeal.registration.measures import beyond_cut, scan_to_mesh
from corporeal.registration.options import LandmarkStage, RegistrationOptions, SurfaceStage
from corporeal.registration.registration import FailedRegistration, Registration
from corporeal.registration.search import search_starts
from corporeal.registration.signals import measured_signals
from corporeal.registration.stages import Fitter, MeasuredLandmarks
from corporeal.registration.starts import average_scale, landmark_start, start_poses
from corporeal.registration.target import Target
from corporeal.scans.scan import Scan
from corporeal.solve.dogleg import Solution
from corporeal.terms.model_fields import MODEL

OnStep = Callable[[str], None]
# Where the views' labels leave less than this to the other side, it is not tried.
_CLEAR_SIDE = 0.15
# A start with fewer scan points on the hand's side of the wrist has nothing to fit to.
_FEWEST_POINTS = 100
# Two starts whose vertices are nowhere farther apart (metres) are one.
_APART = 15e-3
# Hands are tried after every surface stage but the first, where the arms do not lie well yet, and once more
# from where that put elbow and hand. Over five first frames of sequences hands lay 18.6 mm off after two
# rounds behind the second stage, and 14.3 mm with two more behind the third and fingers held from then on.
_HAND_ROUNDS = 2
# How firmly the body is led to them, metres; every vertex that leads has a share of it (``hand_starts``).
_LED_SIGMA = 20e-3
_STATUSES = ("ok", "doubtful", "failed")
# Kept as long as the model is: a session registers thousands of scans with two models.
_MIRRORED: WeakKeyDictionary[SurfaceModel, SurfaceModel] = WeakKeyDictionary()


def model_of_side(model: SurfaceModel, side: Side | None) -> SurfaceModel:
    """The model itself, or its mirror image where the other side is asked for.

    Raises:
        ValueError: a side is asked of a model that has none.
    """
    if side is not None and model.side is None:
        raise ValueError(
            f"side: the model {model.name!r} does not say which side it is, so that {side!r} cannot be made "
            "of it; leave --side out, or give a model with a side"
        )
    if side is None or model.side == side:
        return model
    mirrored = _MIRRORED.get(model)
    if mirrored is None:
        mirrored = _MIRRORED[model] = mirror_model(model)
    return mirrored


def register(
    scan: Scan,
    model: SurfaceModel,
    evidence: LandmarkEvidence | None = None,
    side: Side | None = None,
    options: RegistrationOptions | None = None,
    on_step: OnStep | None = None,
) -> Registration | FailedRegistration:
    """Register one scan.

    Args:
        scan: in metres; with the unit "free" its scale is estimated from the landmarks or by search.
        model: a model of either side; it is mirrored where the scan is of the other one.
        evidence: landmarks; None searches over orientation (and side) by surface distance.
        side: "left" or "right" where it is known; for a model without a side it is left aside, and noted.
        options: stages and weights.
        on_step: told the name of every stage as it begins.

    Returns:
        A registration with its status, or a failure with its reason; bad scans do not raise.
    """
    clock = _Clock(on_step or (lambda _: None))
    options = options or RegistrationOptions()
    known = None if model.side is None else side
    with clock.stage("start"):
        begun = _best_start(scan, model, evidence, known, options)
    if isinstance(begun, str):
        return FailedRegistration(scan, begun, clock.seconds)
    fitter, vector = begun
    result = _through_all_stages(fitter, vector, clock)
    for _ in range(options.second_starts):
        if result.status == "ok":
            break
        with clock.stage("second start"):
            again = _second_start(fitter, result)
        if again is None:
            break
        result = _better(result, _through_all_stages(fitter, again, clock))
    if isinstance(result, FailedRegistration):
        return result
    return dataclasses.replace(result, notes=_side_notes(model, result.side, side))


def _side_notes(model: SurfaceModel, used: Side | None, asked: Side | None) -> tuple[str, ...]:
    """What was done about the side."""
    if model.side is None:
        unused = f"the model has no side: that the scan is of a {asked} one was not used"
        return () if asked is None else (unused,)
    return () if used == model.side else (f"the {model.side} model was mirrored to a {used} one",)


def _through_all_stages(
    fitter: Fitter, vector: Float[np.ndarray, " Q"], clock: _Clock
) -> Registration | FailedRegistration:
    options = fitter.options
    with clock.stage("surface"):
        for number, stage in enumerate(options.surface[1:], start=2):
            fitter, vector = _at_average_size(fitter, vector)
            solution = fitter.fit_surface(vector, stage)
            if not solution.outcome.usable:
                return _failed(fitter, f"surface stage {number}", solution, clock)
            vector = solution.state.parameters
            if options.hands:
                with clock.stage("hands"):
                    fitter, vector = _hands_mended(fitter, vector, stage)
    with clock.stage("free vertices"):
        vertices = fitter.fields.derive(vector)[MODEL]
        for number, free_stage in enumerate(options.free, start=1):
            solution = fitter.fit_free(vector, vertices, free_stage)
            if not solution.outcome.usable or solution.state.free is None:
                return _failed(fitter, f"free-vertex stage {number}", solution, clock)
            vector, vertices = solution.state.parameters, solution.state.free
    with clock.stage("measure"):
        return _measured(fitter, vector, vertices, clock.seconds)


def _hands_mended(
    fitter: Fitter, vector: Float[np.ndarray, " Q"], stage: SurfaceStage
) -> tuple[Fitter, Float[np.ndarray, " Q"]]:
    """Every hand in the pose that the scan speaks for, and the body led to it: its arms may be too short."""
    stage = dataclasses.replace(stage, landmark_sigma=_LED_SIGMA)
    tried: list[HandTried] = []
    for _ in range(_HAND_ROUNDS):
        parameters = fitter.fields.parameters(vector)
        found, tried = hands_tried(fitter.model, fitter.target.scan, parameters, tried)
        if not tried:
            break
        names = [hand.name for hand in tried]
        fingers = {name: found.pose[list(fitter.model.block(name).joints)] for name in names}
        marks = hand_landmarks(fitter.model, tried)
        led = fitter.led_to(marks, tuple(f"{name}_" for name in names), fingers)
        solution = led.fit_surface(found.vector(), stage)
        if not solution.outcome.usable:
            break
        fitter, vector = led, solution.state.parameters
    return fitter, vector


def _second_start(
    fitter: Fitter, result: Registration | FailedRegistration
) -> Float[np.ndarray, " Q"] | None:
    """For a fit that is not good: limbs tried in other poses, and the wide stage again."""
    if isinstance(result, FailedRegistration) or fitter.target.scan.unit.name == "free":
        return None
    parameters = result.parameters
    vector = np.concatenate(
        [parameters.translation, parameters.pose.ravel(), parameters.shape[: fitter.fields.shape_count]]
    )
    solution = fitter.fit_surface(limbs_tried(fitter, vector), fitter.options.surface[0])
    return solution.state.parameters if solution.outcome.usable else None


def _better(
    first: Registration | FailedRegistration, second: Registration | FailedRegistration
) -> Registration | FailedRegistration:
    """The one with the better status; of equals, the one that the scan lies closer to."""
    if isinstance(first, FailedRegistration) or isinstance(second, FailedRegistration):
        return first if isinstance(second, FailedRegistration) else second
    ranks = [_STATUSES.index(result.status) for result in (first, second)]
    if ranks[0] != ranks[1]:
        return first if ranks[0] < ranks[1] else second
    distances = [result.distances.summary_mm()["mean"] for result in (first, second)]
    return second if distances[1] < distances[0] else first


def _failed(fitter: Fitter, stage: str, solution: Solution, clock: _Clock) -> FailedRegistration:
    reason = f"{stage} {solution.outcome.value}; look at the scan, or give --landmarks, --side or --unit"
    return FailedRegistration(fitter.target.scan, reason, clock.seconds)


def _at_average_size(
    fitter: Fitter, vector: Float[np.ndarray, " Q"]
) -> tuple[Fitter, Float[np.ndarray, " Q"]]:
    """For a scan without a unit: the scale at which the hand fitted so far has the average size."""
    if fitter.target.scan.unit.name != "free":
        return fitter, vector
    factor, moved = average_scale(fitter.model, vector, fitter.fields.parameters(vector).pose)
    return fitter.rescaled(1 / factor), moved


def _best_start(
    scan: Scan,
    model: SurfaceModel,
    evidence: LandmarkEvidence | None,
    side: Side | None,
    options: RegistrationOptions,
) -> tuple[Fitter, Float[np.ndarray, " Q"]] | str:
    """First rough surface fit per side that is in question; the one that lies closer is kept."""
    best: tuple[float, Fitter, np.ndarray] | None = None
    target = Target(scan)
    for candidate in _sides_in_question(model, evidence, side):
        sided = model_of_side(model, candidate)
        starts = (
            search_starts(sided, target, options)
            if evidence is None
            else _landmark_starts(sided, target, evidence, options)
        )
        for fitter, vector in starts:
            if len(fitter.near_points(vector).positions) < _FEWEST_POINTS:
                continue
            solution = fitter.fit_surface(vector, options.surface[0])
            if not solution.outcome.usable:
                continue
            if best is None or solution.cost < best[0]:
                best = (solution.cost, fitter, solution.state.parameters)
    if best is None:
        return "no start led to a fit: the scan may not be a hand, or its unit may be wrong (--unit)"
    return best[1], best[2]


def _sides_in_question(
    model: SurfaceModel, evidence: LandmarkEvidence | None, side: Side | None
) -> list[Side | None]:
    if side is not None or model.side is None:
        return [side]
    probability = 0.5 if evidence is None else evidence.right_probability
    sides: list[Side | None] = ["right", "left"] if probability >= 0.5 else ["left", "right"]
    return sides[:1] if min(probability, 1 - probability) < _CLEAR_SIDE else sides


def _landmark_starts(
    model: SurfaceModel, target: Target, evidence: LandmarkEvidence, options: RegistrationOptions
) -> Iterator[tuple[Fitter, Float[np.ndarray, " Q"]]]:
    """Fits to landmarks from several poses, 20 ms each, because the mixture prior has many valleys.

    The best of them with landmarks that may be wrong, and the best with landmarks that are trusted, where the
    two differ: a robust kernel gives up a finger that the detector saw rightly in a pose that the prior does
    not know (10 of the 17 worst of a session), a trusting one follows a wrong landmark. The surface decides.
    """
    if evidence.set_name not in model.landmarks:
        raise ValueError(f"evidence: the model has no landmark set {evidence.set_name!r}")
    known = model.landmarks[evidence.set_name]
    unknown = sorted(set(evidence.positions) - set(known.names))
    if unknown:
        raise ValueError(f"evidence: {unknown[0]!r} is not a landmark of {evidence.set_name!r}")
    names = [name for name in known.names if name in evidence.positions]
    measured = MeasuredLandmarks(
        known.reordered(names),
        np.array([evidence.positions[name] for name in names]),
        np.array([evidence.sigmas.get(name, 1.0) for name in names]),
    )
    whole = Fitter(model, target, measured, options)
    poses = start_poses(model)
    if options.pose_prior is not None:
        poses.insert(0, options.pose_prior.for_side(model.side).pose)
    best: list[tuple[Fitter, np.ndarray]] = []
    for stage in (options.landmarks, options.trusting_landmarks):
        fits = [_landmark_fit(whole, pose, stage) for pose in poses]
        usable = [fit for fit in fits if fit[1].outcome.usable]
        if usable:
            fitter, solution = min(usable, key=lambda fit: fit[1].cost)
            best.append((fitter, solution.state.parameters))
    if len(best) == 2 and _alike(*best):
        best.pop()
    yield from best


def _alike(one: tuple[Fitter, np.ndarray], other: tuple[Fitter, np.ndarray]) -> bool:
    """Whether two starts are nowhere far apart: then one surface fit is enough."""
    vertices = [fitter.fields.evaluated(vector).vertices for fitter, vector in (one, other)]
    return bool(np.linalg.norm(vertices[0] - vertices[1], axis=1).max() < _APART)


def _landmark_fit(
    fitter: Fitter, pose: Float[np.ndarray, "K 3"], options: LandmarkStage
) -> tuple[Fitter, Solution]:
    """Lay a pose onto the landmarks and fit; without a unit, scale and pose are found in three rounds."""
    free_scale = fitter.target.scan.unit.name == "free"
    for _ in range(3 if free_scale else 1):
        marks = fitter.landmarks
        if marks is None:
            raise ValueError("landmark fit: there are no landmarks")
        weights = 1 / marks.relative_sigmas**2
        start, scale = landmark_start(
            fitter.model, marks.landmark_set, marks.positions, weights, pose, fitter.fields.shape_count
        )
        if free_scale:
            fitter = fitter.rescaled(1 / scale)
            marks = fitter.landmarks or marks
            start, _ = landmark_start(
                fitter.model, marks.landmark_set, marks.positions, weights, pose, fitter.fields.shape_count
            )
        solution = fitter.fit_landmarks(start, options)
        if not solution.outcome.usable:
            break
        pose = fitter.fields.parameters(solution.state.parameters).pose.copy()
        pose[0] = 0
    return fitter, solution


def _measured(
    fitter: Fitter, vector: np.ndarray, vertices: np.ndarray, seconds: dict[str, float]
) -> Registration:
    model, scan = fitter.model, fitter.target.scan
    scan = dataclasses.replace(scan, repairs=fitter.target.measured.repairs)
    posed = fitter.fields.evaluated(vector)
    beyond = beyond_cut(scan.points, model.cut, posed)
    normals = None if scan.is_point_cloud else scan.normals
    distances = scan_to_mesh(fitter.surface, vertices, scan.points, beyond, normals)
    model_distances = scan_to_mesh(fitter.surface, posed.vertices, scan.points, beyond)
    parameters = fitter.fields.parameters(vector)
    signals = measured_signals(fitter, vector, vertices, distances, model_distances)
    verdict = verdict_of(signals, fitter.options.bounds)
    landmarks: dict[str, np.ndarray] = {}
    for landmark_set in list(model.landmarks.values())[:1]:
        positions = landmark_set.positions(posed.vertices, posed.joints)
        landmarks = dict(zip(landmark_set.names, positions, strict=True))
    return Registration(
        scan=scan,
        model=model,
        parameters=parameters,
        model_vertices=posed.vertices,
        vertices=vertices,
        landmarks=landmarks,
        distances=distances,
        model_distances=model_distances,
        status=verdict.status,
        reason=verdict.reason,
        signals=verdict.signals,
        correctives=fitter.options.correctives,
        seconds=seconds,
    )


class _Clock:
    """Wall time by stage, without that of the stages within it."""

    def __init__(self, on_step: OnStep) -> None:
        self.seconds: dict[str, float] = {}
        self._on_step = on_step
        self._within = 0.0

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        self._on_step(name)
        begun, outer, self._within = time.perf_counter(), self._within, 0.0
        try:
            yield
        finally:
            whole = time.perf_counter() - begun
            self.seconds[name] = self.seconds.get(name, 0.0) + whole - self._within
            self._within = outer + whole
