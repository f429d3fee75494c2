"""One frame's pose: points of a scan, a model, a start; a few solves of annealed energies."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from corporeal.fitting.arms import Arm, ArmPart
from corporeal.fitting.finger_search import Comparison, FingerSearch, LostFingers
from corporeal.fitting.frame_data import FramePoints, HandFaces, PointShares, chosen_points, seen_shares
from corporeal.fitting.free_vertices import coupled_vertices
from corporeal.fitting.options import AnnealingStep, FreeStage, TrackingOptions
from corporeal.fitting.pose_terms import pose_terms, tracking_subspace
from corporeal.geometry.closest_points import ClosestPoints
from corporeal.model.surface_model import SurfaceModel
from corporeal.scans.scan import Scan
from corporeal.solve.dogleg import DoglegOptions, Solution, solve, solve_within
from corporeal.solve.problem import Problem, State, Term
from corporeal.terms.distance import DistanceOptions
from corporeal.terms.gaussian_prior import GaussianPrior
from corporeal.terms.hinges import HINGE_SIGMA, hinge_terms
from corporeal.terms.model_fields import MODEL, ModelFields
from corporeal.terms.scan_to_surface import MovingSurface, ScanToSurface
from corporeal.terms.surface_to_scan import STICKING_OUT, ScanSurface, SurfaceToScan

# Curvature along the surface as a share of that across it, as in registration.
_TANGENTIAL = 0.1
# Equation 13: the share of the way back from the model to the scan; that of hands is an option.
_BODY_BACK = 1.0
# After the first frame: asked in solves with a robust scale so narrow, metres, and of hands that are seen.
_BACK_WITHIN = 0.02
# Of a body's 50,000 points 12,000 clusters, a centimetre apart, lie 1.5 mm within toes and 0.8 within
# fingers, which distances back then drew in; all of them cost 0.2 s of a frame.
_SURFACE_POINTS = 48_000
# The pull of what is not seen to its last pose, as a multiple of the usual: otherwise others' skin draws a
# missing arm along, which sank into a thigh by 0.2 m within 15 frames.
_UNSEEN = 30.0
# That of fingers in a second try, whose first solve looks 15 cm far: with 1 a joint turned by 21 degrees.
_FINGERS_ANEW = 4.0
_STRAY_MM = 60.0


@dataclass(frozen=True, eq=False)
class FrameStart:
    """Where a frame's fit starts, and what holds it.

    Attributes:
        vector: (Q,) parameters.
        previous: pose of the last good frame for the zero-velocity term, or None.
        first: whether only a rough pose is known: distances back are asked in all solves, and the
            zero-velocity term is of fingers and of what is not seen alone.
        back: the scan's surface, for distances both ways; or None.
        shape: (s,) that of the frames before, ``shapes`` of them, for the prior of equation 12; or None.
        shapes: how many frames have told the shape.
    """

    vector: Float[np.ndarray, " Q"]
    previous: Float[np.ndarray, "K 3"] | None = None
    first: bool = False
    back: ScanSurface | None = None
    shape: Float[np.ndarray, " s"] | None = None
    shapes: int = 0


@dataclass(frozen=True, eq=False)
class HandsAsked:
    """Which hands' fingers are looked for in a frame.

    Attributes:
        settled: hands that nothing speaks against.
        anew: of these, those whose fingers are also begun anew.
        back: hands that were out of sight in the last frame: they are turned about their forearm as well.
        before: the last pose, of hands that are back.
    """

    settled: Bool[np.ndarray, " H"]
    anew: Bool[np.ndarray, " H"]
    back: Bool[np.ndarray, " H"]
    before: Float[np.ndarray, "K 3"]


@dataclass(frozen=True, eq=False)
class FrameMeasures:
    """How a posed model lies in its scan.

    Attributes:
        s2m_mm: distances of scan points to the model.
        seen: shares of the model and of each hand and forearm that the scan confirms.
        stray: share of the scan points that lie farther from the model than one person's skin from another's.
    """

    s2m_mm: dict[str, float]
    seen: dict[str, float]
    stray: float

    @property
    def signals(self) -> dict[str, float]:
        """All shares in one, and the mean distance."""
        return self.seen | {"stray": self.stray, "model_s2m_mm": self.s2m_mm["mean"]}


class FrameFitter:
    """A model made ready for frame after frame: trees, sparsity and subspace are made once."""

    def __init__(self, model: SurfaceModel, options: TrackingOptions, *, shape_count: int = 0) -> None:
        self.model = model
        self.options = options
        self.fields = ModelFields(model, shape_count=shape_count)
        self.surface = MovingSurface(model.template, model.faces)
        self.hands = HandFaces.of_model(model)
        self.on_hands = self.hands.any_hand(len(model.faces))
        self._point_shares = PointShares.of_model(model, self.on_hands, options)
        # Of a whole body the scan's hands are webs between fingers, which free vertices must not follow.
        self._webbed = self.on_hands if model.side is None else np.zeros(len(model.faces), dtype=bool)
        self._hand_vertices = np.zeros(model.vertex_count, dtype=bool)
        self._hand_vertices[np.unique(model.faces[self.on_hands])] = True
        hinges = hinge_terms(model, self.fields.columns, HINGE_SIGMA)
        self._arms = [Arm.of_hand(model, hinges, name, mask) for name, mask in self.hands.masks.items()]
        self._subspace = tracking_subspace(model, self.fields.columns, options)
        self._fingers = [
            FingerSearch.of_block(model, model.block(name), mask) for name, mask in self.hands.masks.items()
        ]

    def fit(self, points: FramePoints, start: FrameStart, steps: tuple[AnnealingStep, ...]) -> Solution:
        """Solve the steps one after the other; the last solution, which may not be usable."""
        vector = start.vector
        solution: Solution | None = None
        for step in steps:
            problem = Problem(
                self._terms(points, vector, start, step), self.fields.derive, self.fields.differentiate
            )
            limits = DoglegOptions(iterations=step.iterations, relative_decrease=1e-3)
            if self._subspace is None:
                solution = solve(problem, State(vector), limits)
            else:
                solution = solve_within(problem, self._subspace, State(vector), limits)
            if not solution.outcome.usable:
                return solution
            vector = solution.state.parameters
        if solution is None:
            raise ValueError("steps: expected at least one")
        return solution

    def measured(self, points: FramePoints, vector: Float[np.ndarray, " Q"]) -> FrameMeasures:
        """Distances of all sampled points to the posed model, and what they confirm of it."""
        vertices = self.fields.evaluated(vector).vertices
        closest = self.surface.closest(vertices, points.positions, None)
        mm = 1e3 * closest.distances
        shares = seen_shares(points, closest, vertices, self.surface, self.hands)
        return FrameMeasures(_summary(mm), shares, float((mm > _STRAY_MM).mean()))

    def freed(
        self, points: FramePoints, posed: Float[np.ndarray, "V 3"], stage: FreeStage
    ) -> Float[np.ndarray, "V 3"]:
        """The free vertices of equations 20 and 23 about those of a fitted pose, metres.

        Raises:
            ArithmeticError: the system is singular.
        """
        return coupled_vertices(posed, self.surface, points, self.options, self._webbed, stage)

    def s2m_mm(self, points: FramePoints, vertices: Float[np.ndarray, "V 3"]) -> dict[str, float]:
        """Distances of all sampled points to a surface: mean, median, p95 and under_1mm."""
        return _summary(1e3 * self.surface.closest(vertices, points.positions, None).distances)

    def arms_sought(
        self, points: FramePoints, vector: Float[np.ndarray, " Q"], measures: FrameMeasures
    ) -> list[Float[np.ndarray, " Q"]]:
        """The parameters with an arm of a missing hand laid to where the scan has points left over.

        Several poses of one arm, where one can be laid so, the likeliest first; or nothing.

        Args:
            points: of the frame.
            vector: parameters that fit the rest of the body.
            measures: of these.
        """
        vertices = self.fields.evaluated(vector).vertices
        closest = self.surface.closest(vertices, points.positions, None)
        stray = points.positions[1e3 * closest.distances > _STRAY_MM]
        for arm in self._arms if len(stray) else ():
            if arm.missing(measures.seen) is not None and arm.search is not None:
                found = arm.search.nearest(self.fields, self.surface, vector, stray)
                if found:
                    return found
        return []

    def with_fingers(
        self, points: FramePoints, vector: Float[np.ndarray, " Q"], start: FrameStart, asked: HandsAsked
    ) -> Float[np.ndarray, " Q"]:
        """The parameters with fingers that had lost their scan found again, where they are.

        Args:
            points: of the frame.
            vector: parameters that fit it.
            start: what it was fitted from; without a scan's surface no fingers are looked for.
            asked: which hands' fingers may be looked for, and how.
        """
        options = self.options
        if start.back is None or not options.find_fingers or options.hands == "flat":
            return vector
        for hand, search in enumerate(self._fingers):
            if not (asked.settled[hand] or asked.back[hand]):
                continue
            lost = search.lost(
                self.fields.evaluated(vector).vertices, points.positions, start.back,
                however_little=bool(asked.back[hand]),
            )  # fmt: skip
            if lost is None:
                continue
            begins = self._begins(lost, vector, start.back, asked, hand)
            tried = (self._from_fingers(points, start, begin, steps) for begin, steps in begins)
            solved = [one for one in tried if one is not None]
            costs = [lost.cost_of(self.fields.evaluated(one).vertices, start.back) for one in solved]
            if costs and lost.found(min(costs), turned=bool(asked.back[hand])):
                vector = solved[int(np.argmin(costs))]
        return vector

    def _begins(
        self,
        lost: LostFingers,
        vector: Float[np.ndarray, " Q"],
        scan: ScanSurface,
        asked: HandsAsked,
        hand: int,
    ) -> list[tuple[Float[np.ndarray, " Q"], tuple[AnnealingStep, ...]]]:
        """Where solves for a hand's fingers begin, and by which steps."""
        options = self.options
        if asked.back[hand]:
            return [(begin, options.first) for begin in lost.turned(self.fields, vector, asked.before)]
        sought = lost.sought(self.fields, vector, scan)
        begins = [] if sought is None else [(sought, options.annealing[-1:])]
        if asked.anew[hand]:
            begins += [(begin, options.first) for begin in lost.anew(self.fields, vector, scan)]
        return begins

    def _from_fingers(
        self, points: FramePoints, start: FrameStart, begin: Float[np.ndarray, " Q"],
        steps: tuple[AnnealingStep, ...],
    ) -> Float[np.ndarray, " Q"] | None:  # fmt: skip
        """A frame solved again with other fingers; None where that leads nowhere."""
        held = self.fields.parameters(begin).pose
        return self._solved(points, replace(start, vector=begin, previous=held, first=False), steps)

    def _solved(
        self, points: FramePoints, start: FrameStart, steps: tuple[AnnealingStep, ...]
    ) -> Float[np.ndarray, " Q"] | None:
        solution = self.fit(points, start, steps)
        found = solution.state.parameters
        return found if solution.outcome.usable and np.isfinite(found).all() else None

    def fingers_again(
        self, points: FramePoints, tracked: Float[np.ndarray, " Q"], start: FrameStart, hand: str
    ) -> tuple[Float[np.ndarray, " Q"], Comparison] | None:
        """The frame solved from other fingers of a hand, and how what was tracked compares with that.

        None where the solve leads nowhere.

        Args:
            points: of the frame.
            tracked: its parameters.
            start: the same with the other fingers.
            hand: the name of its block.
        """
        search = self._fingers[list(self.hands.masks).index(hand)]
        found = self._solved(points, start, self.options.annealing[-1:])
        if found is None:
            return None
        before, after = (self.fields.evaluated(vector).vertices for vector in (tracked, found))
        return found, search.compared(before, after, points.positions, start.back)

    def unseen_hands(self, measures: FrameMeasures) -> Bool[np.ndarray, " H"]:
        """Hands of which so little is seen that they may be missing."""
        return np.array([arm.missing(measures.seen) is not None for arm in self._arms], dtype=bool)

    def _back_terms(
        self, scan: ScanSurface, weight: float, asked: Bool[np.ndarray, " V"], first: bool,
        distance: DistanceOptions,
    ) -> list[Term]:  # fmt: skip
        """Distances back to the scan, of the vertices ``asked``.

        The body is asked everywhere: with vertices outside of the scan alone it was 0.4 mm farther off. Of a
        fist half the skin is hidden: there, only what is outside counts. Later than in the first frame, what
        sticks out of a hole in a hand may be what is missing.
        """
        body = weight * _BODY_BACK * (asked & ~self._hand_vertices)
        hands = weight * self.options.hand_back * (asked & self._hand_vertices)
        edge = STICKING_OUT if first else np.inf
        return [
            SurfaceToScan("body back", MODEL, self.surface, scan, body, distance),
            SurfaceToScan("hands back", MODEL, self.surface, scan, hands, distance, True, edge),
        ]

    def _unseen(
        self, points: FramePoints, closest: ClosestPoints, vertices: Float[np.ndarray, "V 3"]
    ) -> list[ArmPart]:
        """What is missing of arms whose hands are.

        All skin of a missing hand lies outside of the scan: asked for distances back, it would be drawn to
        the nearest thigh.
        """
        shares = seen_shares(points, closest, vertices, self.surface, self.hands)
        return [part for arm in self._arms if (part := arm.missing(shares)) is not None]

    def _terms(
        self, points: FramePoints, vector: np.ndarray, start: FrameStart, step: AnnealingStep
    ) -> list[Term]:
        options, weights, columns = self.options, self.options.weights, self.fields.columns
        cosine = -1.0 if points.normals is None else options.minimum_cosine
        sigma = float(1 / np.sqrt(step.weight * weights.data))
        distance = DistanceOptions(sigma, step.robust_scale, _TANGENTIAL, cosine)
        vertices = self.fields.evaluated(vector).vertices
        closest = self.surface.closest(vertices, points.positions, None)
        own = self._own_shares(points, closest, vertices)
        kept, shares = chosen_points(closest, self._point_shares, own, options)
        near = points.some(kept)
        terms: list[Term] = [
            ScanToSurface(
                "scan", MODEL, self.surface, near.positions, shares, near.normals, distance,
                closest.faces[kept],
            )
        ]  # fmt: skip
        unseen = [] if start.previous is None else self._unseen(points, closest, vertices)
        if start.back is not None and (start.first or step.robust_scale <= _BACK_WITHIN):
            # Of all points, as if those on hands weighed no more than others.
            weight = float(np.minimum(shares, 1.0).sum()) / self.model.vertex_count
            asked = np.ones(self.model.vertex_count, dtype=bool)
            for part in unseen:
                asked[part.vertices] = False
            terms += self._back_terms(start.back, weight, asked, start.first, distance)
        size = columns.shape.stop - columns.shape.start
        if size:
            # A person has one shape: a frame is held to the mean of those before, more with each of them.
            spread = float(1 / np.sqrt(weights.shape * (1 + start.shapes) ** 2))
            middle = np.zeros(size) if start.shape is None else start.shape
            terms.append(GaussianPrior.isotropic("shape prior", columns.shape, middle, spread))
        held = size > 0 or start.first
        return terms + pose_terms(
            self.model, columns, options, step.weight,
            previous=start.previous, body_prior=held, pull=self._pull(start, unseen),
        )  # fmt: skip

    def _own_shares(
        self, points: FramePoints, closest: ClosestPoints, vertices: Float[np.ndarray, "V 3"]
    ) -> Float[np.ndarray, " n"]:
        """How surely every point nearest to a hand is the hand's; 1 for all others."""
        share = np.ones(len(points.positions))
        for search, mask in zip(self._fingers, self.hands.masks.values(), strict=True):
            own = np.flatnonzero(mask[closest.faces])
            share[own] = search.own_shares(vertices, points.positions[own], closest.distances[own])
        return share

    def _pull(self, start: FrameStart, unseen: list[ArmPart]) -> Float[np.ndarray, " K"]:
        """Factors on the pull of every joint to its last pose."""
        pull = np.zeros(self.model.joint_count) if start.first else np.ones(self.model.joint_count)
        # Where the body is looked for anew, how its hands are closed has not changed with that.
        for arm in self._arms:
            pull[list(arm.fingers)] = _FINGERS_ANEW if start.first else 1.0
        for part in unseen:
            pull[list(part.joints)] = _UNSEEN
        return pull


def _summary(mm: Float[np.ndarray, " n"]) -> dict[str, float]:
    return {
        "mean": float(mm.mean()),
        "median": float(np.median(mm)),
        "p95": float(np.percentile(mm, 95)),
        "under_1mm": float((mm < 1).mean()),
    }


def scan_surface(scan: Scan) -> ScanSurface | None:
    """A scan's triangles, fewer where it has many; None for a point cloud."""
    if scan.is_point_cloud:
        return None
    return ScanSurface.of_mesh(scan.points, scan.faces, _SURFACE_POINTS)
