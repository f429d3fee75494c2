"""One scan, from landmarks or from nothing, to a registration."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from corporeal.model.mirror import mirror_model
from corporeal.model.surface_model import Side, SurfaceModel
from corporeal.registration.judgement import judge
from corporeal.registration.measures import beyond_cut, scan_to_mesh
from corporeal.registration.options import RegistrationOptions
from corporeal.registration.registration import FailedRegistration, Registration
from corporeal.registration.search import search_starts
from corporeal.registration.stages import Fitter, MeasuredLandmarks
from corporeal.registration.starts import landmark_start, start_poses
from corporeal.registration.target import Target
from corporeal.scans.scan import Scan
from corporeal.terms.model_fields import MODEL

OnStep = Callable[[str], None]
# Below this share of the better side's cost the other side is not worth a second look.
_CLEAR_SIDE = 0.15


@dataclass(frozen=True, eq=False)
class LandmarkEvidence:
    """Landmarks of a scan as found or given.

    Attributes:
        positions: landmark name -> (3,) metres, in the scan's frame.
        sigmas: landmark name -> standard deviation relative to the others; 1 where it has no entry.
        right_probability: how likely it is a right hand; 0.5 where nothing is known.
        set_name: which of the model's landmark sets the names belong to.
    """

    positions: Mapping[str, np.ndarray]
    sigmas: Mapping[str, float]
    right_probability: float
    set_name: str


def model_of_side(model: SurfaceModel, side: Side | None) -> SurfaceModel:
    """The model itself, or its mirror image where the other side is asked for."""
    if side is None or model.side is None or model.side == side:
        return model
    return mirror_model(model)


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
        side: "left" or "right" where it is known.
        options: stages and weights.
        on_step: told the name of every stage as it begins.

    Returns:
        A registration with its status, or a failure with its reason; bad scans do not raise.
    """
    clock = _Clock(on_step or (lambda _: None))
    options = options or RegistrationOptions()
    with clock.stage("start"):
        begun = _best_start(scan, model, evidence, side, options)
    if isinstance(begun, str):
        return FailedRegistration(scan, begun, clock.seconds)
    fitter, vector = begun
    with clock.stage("surface"):
        for stage in options.surface[1:]:
            solution = fitter.fit_surface(vector, stage)
            if not solution.outcome.usable:
                return FailedRegistration(fitter.target.scan, solution.outcome.value, clock.seconds)
            vector = solution.state.parameters
    with clock.stage("free vertices"):
        vertices = fitter.fields.derive(vector)[MODEL]
        for free_stage in options.free:
            solution = fitter.fit_free(vector, vertices, free_stage)
            if not solution.outcome.usable or solution.state.free is None:
                return FailedRegistration(fitter.target.scan, solution.outcome.value, clock.seconds)
            vector, vertices = solution.state.parameters, solution.state.free
    with clock.stage("measure"):
        return _measured(fitter, vector, vertices, clock.seconds)


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
            solution = fitter.fit_surface(vector, options.surface[0])
            if not solution.outcome.usable:
                continue
            if best is None or solution.cost < best[0]:
                best = (solution.cost, fitter, solution.state.parameters)
    if best is None:
        return "no start led to a finite fit: the scan may not be a hand, or its unit may be wrong"
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
    known = model.landmarks[evidence.set_name]
    names = [name for name in known.names if name in evidence.positions]
    landmark_set = known.reordered(names)
    positions = np.array([evidence.positions[name] for name in names])
    sigmas = np.array([evidence.sigmas.get(name, 1.0) for name in names])
    shape_count = min(options.shape_count, model.shape_count)
    poses, weights = start_poses(model), 1 / sigmas**2
    if target.scan.unit.name == "free":
        _, scale = landmark_start(model, landmark_set, positions, weights, poses[0], shape_count)
        target, positions = target.scaled(1 / scale), positions / scale
    fitter = Fitter(model, target, MeasuredLandmarks(landmark_set, positions, sigmas), options)
    # The mixture prior has many valleys; a landmark fit costs 20 ms, and the best of three starts is kept.
    solutions = []
    for pose in poses:
        vector, _ = landmark_start(model, landmark_set, positions, weights, pose, shape_count)
        solutions.append(fitter.fit_landmarks(vector, options.landmarks))
    yield fitter, min(solutions, key=lambda solution: solution.cost).state.parameters


def _measured(
    fitter: Fitter, vector: np.ndarray, vertices: np.ndarray, seconds: dict[str, float]
) -> Registration:
    model, scan = fitter.model, fitter.target.scan
    scan = dataclasses.replace(scan, repairs=fitter.target.measured.repairs)
    posed = fitter.fields.evaluated(vector)
    beyond = beyond_cut(scan.points, model.cut, posed)
    distances = scan_to_mesh(fitter.surface, vertices, scan.points, beyond)
    model_distances = scan_to_mesh(fitter.surface, posed.vertices, scan.points, beyond)
    parameters = fitter.fields.parameters(vector)
    verdict = judge(fitter, vector, vertices, distances, model_distances)
    landmarks: dict[str, np.ndarray] = {}
    for landmark_set in model.landmarks.values():
        positions = landmark_set.positions(posed.vertices, posed.joints)
        landmarks.update(zip(landmark_set.names, positions, strict=True))
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
        correctives=fitter.options.correctives,
        seconds=seconds,
    )


class _Clock:
    """Wall time by stage."""

    def __init__(self, on_step: OnStep) -> None:
        self.seconds: dict[str, float] = {}
        self._on_step = on_step

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        self._on_step(name)
        begun = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = time.perf_counter() - begun
