"""The stages of a registration, each a problem of terms solved by dogleg."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass, replace
from weakref import WeakKeyDictionary

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float

from corporeal.geometry.self_intersection import PartSurfaces
from corporeal.model.landmarks import LandmarkSet
from corporeal.model.parts import part_labels
from corporeal.model.surface_model import SurfaceModel
from corporeal.registration.hands_on_arms import on_hands
from corporeal.registration.measures import beyond_cut
from corporeal.registration.options import FreeStage, LandmarkStage, RegistrationOptions, SurfaceStage
from corporeal.registration.priors import prior_terms
from corporeal.registration.target import SampledPoints, Target
from corporeal.solve.dogleg import DoglegOptions, Solution, solve, solve_within
from corporeal.solve.problem import Problem, State, Term
from corporeal.solve.subspace import AffineSubspace
from corporeal.terms.coupling import EdgeCoupling
from corporeal.terms.distance import DistanceOptions
from corporeal.terms.gaussian_prior import GaussianPrior
from corporeal.terms.landmarks import LandmarkDistances
from corporeal.terms.model_fields import LANDMARKS, MODEL, LandmarkFields, ModelFields
from corporeal.terms.part_separation import PartSeparation
from corporeal.terms.pose_subspace import block_columns
from corporeal.terms.scan_to_surface import MovingSurface, ScanToSurface
from corporeal.terms.surface_to_scan import STICKING_OUT, SurfaceToScan

FREE = "free"
# Points this far before the wrist plane still help to place the wrist; farther ones are arm.
_ARM_MARGIN = 0.01
# Curvature along the surface in the model-only stages. Measured on the real scans: 0.1 needs a third of the
# steps of point-to-point; 0 lets a nearly round finger turn about itself.
_TANGENTIAL = 0.1
# How firmly fingers that were found are held, radians.
_HELD = 0.05


@dataclass(frozen=True, eq=False)
class MeasuredLandmarks:
    """Landmarks of a scan: the model's set, positions (N, 3) in metres, and relative sigmas (N,)."""

    landmark_set: LandmarkSet
    positions: Float[np.ndarray, "N 3"]
    relative_sigmas: Float[np.ndarray, " N"]

    def without(self, beginnings: tuple[str, ...]) -> MeasuredLandmarks:
        """Those whose names do not begin so."""
        names = self.landmark_set.names
        kept = [k for k, name in enumerate(names) if not name.startswith(beginnings)]
        left = self.landmark_set.reordered([names[k] for k in kept])
        return MeasuredLandmarks(left, self.positions[kept], self.relative_sigmas[kept])

    def joined(self, other: MeasuredLandmarks) -> MeasuredLandmarks:
        """Both, in this order; no name may stand in both."""
        mine, theirs = self.landmark_set, other.landmark_set
        weights = sp.vstack([mine.weights, theirs.weights]).tocsr()
        return MeasuredLandmarks(
            LandmarkSet(mine.names + theirs.names, weights, mine.vertex_count),
            np.concatenate([self.positions, other.positions]),
            np.concatenate([self.relative_sigmas, other.relative_sigmas]),
        )


@dataclass(frozen=True, eq=False)
class _Topology:
    """What depends on the model alone, and is the same for every scan of a session."""

    surface: MovingSurface
    parts: PartSurfaces | None
    edge_lengths: Float[np.ndarray, " E"]
    hands: Bool[np.ndarray, " V"]


# Kept as long as the model is: a session registers thousands of scans with two (0.1 s each to make).
_TOPOLOGIES: WeakKeyDictionary[SurfaceModel, _Topology] = WeakKeyDictionary()


class Fitter:
    """A model being fitted to one scan: topology, fields and search trees are made once for all stages.

    Fitters of one model share its trees, which move with the surface: not for several threads at once.
    """

    def __init__(
        self,
        model: SurfaceModel,
        target: Target,
        landmarks: MeasuredLandmarks | None,
        options: RegistrationOptions,
    ) -> None:
        self.model = model
        self.target = target
        self.landmarks = landmarks
        self.options = options
        self.fields = ModelFields(
            model,
            shape_count=min(options.shape_count, model.shape_count),
            landmarks=None if landmarks is None else landmarks.landmark_set,
            correctives=options.correctives,
        )
        topology = _topology(model)
        self.surface, self.parts = topology.surface, topology.parts
        self._subspace: AffineSubspace | None = None
        self._held: Mapping[str, Float[np.ndarray, "n 3"]] = {}

    def within(self, subspace: AffineSubspace | None) -> Fitter:
        """The same fit with the parameters of its model stages held to a subspace; None frees them."""
        other = copy.copy(self)
        other._subspace = subspace
        return other

    def rescaled(self, factor: float) -> Fitter:
        """The same fit with another estimate of the scan's scale; itself where the factor is 1."""
        if factor == 1.0:
            return self
        other = copy.copy(self)
        other.target = self.target.scaled(factor)
        if self.landmarks is not None:
            other.landmarks = replace(self.landmarks, positions=factor * self.landmarks.positions)
        return other

    def led_to(
        self,
        marks: MeasuredLandmarks,
        dropped: tuple[str, ...],
        fingers: Mapping[str, Float[np.ndarray, "n 3"]],
    ) -> Fitter:
        """The same fit with more landmarks, and with fingers held to a pose.

        Args:
            marks: further landmarks.
            dropped: landmarks whose names begin with one of these are left out.
            fingers: pose block -> (n, 3) radians, where its joints are held from now on. A body's own stages
                have few points on a hand: without this they undid a third to all of what was found
                (``hand_starts``).
        """
        other = copy.copy(self)
        other._held = {**self._held, **fingers}
        other.landmarks = marks if self.landmarks is None else self.landmarks.without(dropped).joined(marks)
        other.fields = ModelFields(
            self.model,
            shape_count=self.fields.shape_count,
            landmarks=other.landmarks.landmark_set,
            correctives=self.options.correctives,
        )
        return other

    def fit_landmarks(self, start: Float[np.ndarray, " Q"], stage: LandmarkStage) -> Solution:
        """Pose, shape and place from landmarks and priors alone."""
        terms = self._priors(stage.shape_sigma, stage.pose_prior_scale)
        if self.landmarks is None:
            return self._solve_model(terms, start, stage.iterations, self.fields)
        terms += self._landmark_terms(stage.sigma, stage.robust_scale)
        return self._solve_model(terms, start, stage.iterations, self.fields.landmarks_alone)

    def fit_surface(self, start: Float[np.ndarray, " Q"], stage: SurfaceStage) -> Solution:
        """Pose, shape and place from distances both ways."""
        options = DistanceOptions(stage.sigma, stage.robust_scale, _TANGENTIAL, stage.minimum_cosine)
        terms = self._priors(stage.shape_sigma, stage.pose_prior_scale)
        terms += self._landmark_terms(stage.landmark_sigma, 3.0)
        terms.append(self._data_term(MODEL, start, stage.points, stage.observations, options))
        terms += self._way_back(stage, options)
        terms += self._separation(MODEL, stage.separation_sigma)
        return self._solve_model(terms, start, stage.iterations, self.fields)

    def fit_free(
        self, start: Float[np.ndarray, " Q"], vertices: Float[np.ndarray, "V 3"], stage: FreeStage
    ) -> Solution:
        """Free vertices, coupled to a model that follows them (equation 5)."""
        options = DistanceOptions(stage.sigma, stage.robust_scale, 1.0, stage.minimum_cosine)
        terms = self._priors(stage.shape_sigma, stage.pose_prior_scale)
        terms.append(self._data_term(FREE, start, stage.points, stage.observations, options))
        terms.append(self._coupling(stage))
        terms += self._separation(FREE, stage.separation_sigma)
        problem = Problem(terms, self.fields.derive, self.fields.differentiate, free_field=FREE)
        limits = DoglegOptions(iterations=stage.iterations, relative_decrease=1e-3)
        return solve(problem, State(start, vertices), limits)

    def near_points(self, vector: Float[np.ndarray, " Q"]) -> SampledPoints:
        """Samples on the model's side of the cut plane, a little of the arm included."""
        posed = self.fields.evaluated(vector)
        samples = self.target.samples
        return samples.kept(beyond_cut(samples.positions, self.model.cut, posed, _ARM_MARGIN))

    def _priors(self, shape_sigma: float, pose_prior_scale: float) -> list[Term]:
        columns = self.fields.columns
        held = [
            GaussianPrior.isotropic(
                f"{name} held", block_columns(self.model.block(name), columns), pose.ravel(), _HELD
            )
            for name, pose in self._held.items()
        ]
        return held + prior_terms(
            self.model,
            columns,
            shape_sigma=shape_sigma,
            pose_prior_scale=pose_prior_scale,
            limit_sigma=self.options.limit_sigma,
            pose_prior=self.options.pose_prior,
        )

    def _landmark_terms(self, sigma: float, robust_scale: float) -> list[Term]:
        if self.landmarks is None:
            return []
        sigmas = sigma * self.landmarks.relative_sigmas
        return [LandmarkDistances("landmarks", LANDMARKS, self.landmarks.positions, sigmas, robust_scale)]

    def _data_term(
        self, field: str, vector: np.ndarray, count: int, observations: float, options: DistanceOptions
    ) -> ScanToSurface:
        near = self.near_points(vector).first(count)
        weights = np.full(len(near.positions), observations / max(len(near.positions), 1))
        if near.normals is None:
            options = replace(options, minimum_cosine=-1.0)
        return ScanToSurface(
            "scan to surface", field, self.surface, near.positions, weights, near.normals, options
        )

    def _way_back(self, stage: SurfaceStage, options: DistanceOptions) -> list[Term]:
        """From the surface to the scan; of a body's hands only what is outside of it.

        Skin within the scan may be folded skin that nothing saw: with it, closed fists came open again.
        """
        scan = self.target.surface
        if scan is None or stage.scan_share == 0:
            return []
        share = stage.scan_share * stage.observations / self.model.vertex_count
        hands = _topology(self.model).hands
        rest = SurfaceToScan(
            "surface to scan", MODEL, self.surface, scan, np.where(hands, 0.0, share), options
        )
        if not hands.any():
            return [rest]
        weights = np.where(hands, share, 0.0)
        return [
            rest,
            SurfaceToScan("hands to scan", MODEL, self.surface, scan, weights, options, True, STICKING_OUT),
        ]

    def _separation(self, field: str, sigma: float) -> list[Term]:
        if self.parts is None or np.isinf(sigma):
            return []
        pattern = self.surface.pattern
        return [PartSeparation("separation", field, self.surface.faces, self.parts, pattern, sigma)]

    def _coupling(self, stage: FreeStage) -> EdgeCoupling:
        topology = _topology(self.model)
        return EdgeCoupling(
            "coupling",
            (FREE, MODEL),
            topology.surface.edges,
            self.model.vertex_count,
            sigma=stage.coupling_sigma,
            position_sigma=stage.position_sigma,
            weights=1 / topology.edge_lengths**2,
        )

    def _solve_model(
        self, terms: list[Term], start: np.ndarray, iterations: int, fields: ModelFields | LandmarkFields
    ) -> Solution:
        problem = Problem(terms, fields.derive, fields.differentiate)
        limits = DoglegOptions(iterations=iterations, relative_decrease=1e-3)
        if self._subspace is not None:
            return solve_within(problem, self._subspace, State(start), limits)
        return solve(problem, State(start), limits)


def _topology(model: SurfaceModel) -> _Topology:
    found = _TOPOLOGIES.get(model)
    if found is None:
        surface = MovingSurface(model.template, model.faces)
        ends = model.template[surface.edges]
        lengths = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
        found = _Topology(surface, _parts(model), lengths, on_hands(model))
        _TOPOLOGIES[model] = found
    return found


def _parts(model: SurfaceModel) -> PartSurfaces | None:
    if len(model.parts) < 2:
        return None
    return PartSurfaces(model.template, model.faces, part_labels(model))
