"""Hands of a body tried anew: each alone with its forearm, from every pose that the model knows of hands.

A body's fit sees a hand only as well as its detector does, and of fists and half-closed hands that is seldom:
no descent leads straight fingers round into a fist. A hand alone is small, so that a dozen descents cost some
seconds. Which of them is right is told by the scan's distances to the model; of the way back only vertices
outside of the scan count (``SurfaceToScan.outside``): with all of them the wrong poses win.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace
from weakref import WeakKeyDictionary

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float, Int

from corporeal.geometry.closest_points import SurfaceTree
from corporeal.geometry.rotations_numeric import axis_angle_from_matrix, matrix_from_axis_angle
from corporeal.model.jacobian import Evaluated, evaluate
from corporeal.model.landmarks import LandmarkSet
from corporeal.model.parts import select_part
from corporeal.model.surface_model import SurfaceModel
from corporeal.registration.hands_on_arms import is_hand_on_arm
from corporeal.registration.priors import prior_terms
from corporeal.registration.stages import MeasuredLandmarks
from corporeal.registration.target import SURFACE_POINTS
from corporeal.scans.scan import Scan
from corporeal.scans.surface_sampling import sample_surface
from corporeal.solve.dogleg import DoglegOptions, Solution, solve
from corporeal.solve.problem import Problem, State, Term
from corporeal.terms.distance import DistanceOptions
from corporeal.terms.gaussian_prior import GaussianPrior
from corporeal.terms.model_fields import MODEL, ModelFields, ModelParameters
from corporeal.terms.pose_subspace import block_columns
from corporeal.terms.scan_to_surface import MovingSurface, ScanToSurface
from corporeal.terms.surface_to_scan import STICKING_OUT, ScanSurface, SurfaceToScan

# How far the elbow, and the turn of the forearm, may be off in the body's fit: metres, radians.
_ELBOW, _FOREARM = 0.02, 0.25
# Both ways together stand for twice so many observations.
_OBSERVATIONS, _POINTS, _TANGENTIAL, _MINIMUM_COSINE = 400.0, 1500, 0.1, 0.3
# Real fingers leave the ranges of the recorded ones by some degrees.
_PRIOR_SCALE, _LIMIT_SIGMA = 2.0, 0.15
# A wrist that is bent more (radians) is tried straight too: beside a thigh it may be bent the wrong way.
_STRAIGHT = 0.4
# A person's hands are larger or smaller than the body's shape tells, by such a share.
_HAND_SIZE = 0.05
_KEPT = 4
# Weight of the way back: of fists that rest on something it is the less certain of the two.
_BACK = 0.3
# The means of known kinds of poses are tried as they are and bent so much more, to this share of the limits.
_BENT, _BENT_TO = 1.5, 0.9
# What is cut out: the forearm's last three quarters, and what lies about the middle of the hand, metres.
# Points that lie nearer than this to another part of the body are that part's.
_ALONG, _FOREARM_RADIUS, _HAND_AHEAD, _HAND_REACH, _OTHERS = 0.25, 0.07, 0.08, 0.17, 0.03
_FEWEST_POINTS = 150
# From this cost on the forearm is tried turned about itself too, by so many radians.
_TURNED_FROM = 450.0
_TURNS = tuple(np.deg2rad([90.0, -90.0, 180.0]))
# Every so many vertices of an arm lead the body to it; their sigma as a share of a landmark's.
_EVERY, _LED_SIGMA = 40, 0.25


@dataclass(frozen=True)
class _Descent:
    """Robust scale and standard deviation of a distance in metres; most steps.

    ``every``-th points of the scan and vertices are looked at; coarse descents leave pose correctives out.
    """

    robust_scale: float
    sigma: float
    iterations: int
    every: int = 1


_FIRST, _WIDE, _NARROW = _Descent(0.05, 0.004, 2, 3), _Descent(0.05, 0.004, 4, 3), _Descent(0.01, 0.002, 10)
# How many of the starts go on after two steps.
_GOING_ON = 10


@dataclass(frozen=True, eq=False)
class HandTried:
    """What came of one hand.

    Attributes:
        name: of its pose block.
        cost: of the best descent, in half squared standard deviations; ``cost_before`` of that from the pose
            that it had.
        vertices: (n,) of the whole model, on the arm.
        positions: (n, 3) where the best descent put them, metres.
        promising: the poses of fingers whose descents led farthest, for a second round.
    """

    name: str
    cost: float
    cost_before: float
    vertices: Int[np.ndarray, " n"]
    positions: Float[np.ndarray, "n 3"]
    promising: tuple[Float[np.ndarray, " f"], ...]


def hands_tried(
    model: SurfaceModel, scan: Scan, parameters: ModelParameters, before: Sequence[HandTried] = ()
) -> tuple[ModelParameters, list[HandTried]]:
    """The parameters with every hand in the pose whose descent costs least; its own pose is among the starts.

    Elbow, wrist and fingers change. Hands of which the scan shows too little stay as they are and are not in
    the list, as are all of a point cloud, which has no outer side.

    Args:
        model: with pose blocks of hands that hang on a forearm; one without is given back unchanged.
        scan: metres.
        parameters: that fit the body well, its hands perhaps not.
        before: what an earlier round found; only what was promising then is tried again.
    """
    pose = parameters.pose.copy()
    tried: list[HandTried] = []
    promising = {hand.name: hand.promising for hand in before}
    if scan.is_point_cloud:
        return parameters, tried
    posed = evaluate(model, parameters.shape, parameters.pose, parameters.translation)
    for block in model.pose_blocks:
        if not is_hand_on_arm(model, block):
            continue
        arm = _arm_of(model, block.name)
        near = _cut_out(scan, posed, model, arm)
        if near is None:
            continue
        fit = _ArmFit(arm, parameters.shape, near, _pose_of_arm(arm, posed, parameters.pose))
        vector, hand = fit.best_turn(promising.get(block.name))
        pose[arm.joints] = _local_pose(model, arm, posed, vector)
        tried.append(hand)
    return ModelParameters(parameters.translation, pose, parameters.shape), tried


def hand_landmarks(model: SurfaceModel, tried: list[HandTried]) -> MeasuredLandmarks:
    """Vertices of the arms that were tried, as landmarks that lead a body's fit to them."""
    vertices = np.concatenate([hand.vertices[::_EVERY] for hand in tried])
    positions = np.concatenate([hand.positions[::_EVERY] for hand in tried])
    names = tuple(f"vertex {vertex}" for vertex in vertices)
    shape = (len(vertices), model.vertex_count + model.joint_count)
    weights = sp.csr_matrix((np.ones(len(vertices)), (np.arange(len(vertices)), vertices)), shape=shape)
    marks = LandmarkSet(names, weights, model.vertex_count)
    return MeasuredLandmarks(marks, positions, np.full(len(vertices), _LED_SIGMA))


@dataclass(frozen=True, eq=False)
class _Arm:
    """Forearm and hand of a model: ``joints`` and ``vertices`` of the whole, elbow and wrist first."""

    part: SurfaceModel
    joints: Int[np.ndarray, " j"]
    vertices: Int[np.ndarray, " n"]
    surface: MovingSurface
    fingers: Bool[np.ndarray, " n"]


# Kept as long as the model is; cutting a part out takes half a second.
_ARMS: WeakKeyDictionary[SurfaceModel, dict[str, _Arm]] = WeakKeyDictionary()


def _arm_of(model: SurfaceModel, name: str) -> _Arm:
    arms = _ARMS.setdefault(model, {})
    if name not in arms:
        block = next(block for block in model.pose_blocks if block.name == name)
        wrist = int(model.parents[block.joints[0]])
        joints = np.array([int(model.parents[wrist]), wrist, *block.joints])
        vertices = np.flatnonzero(model.skinning_weights[:, joints].sum(axis=1) > 0.7)
        plain = model.replace(expression_directions=np.zeros((model.vertex_count, 3, 0)))
        part = select_part(plain, vertices, joints.tolist(), name=f"{name} and forearm")
        fingers = np.asarray(part.skinning_weights[:, 1:].sum(axis=1) > 0.5)
        arms[name] = _Arm(part, joints, vertices, MovingSurface(part.template, part.faces), fingers)
    return arms[name]


def _cut_out(scan: Scan, posed: Evaluated, model: SurfaceModel, arm: _Arm) -> Scan | None:
    """The scan about an arm; None where too little of a hand is there."""
    elbow, wrist = posed.joints[arm.joints[0]], posed.joints[arm.joints[1]]
    length = float(np.linalg.norm(wrist - elbow))
    forward = (wrist - elbow) / max(length, 1e-9)
    along = (scan.points - elbow) @ forward
    radius = np.linalg.norm(scan.points - elbow - along[:, None] * forward, axis=1)
    on_forearm = (along > _ALONG * length) & (along < length) & (radius < _FOREARM_RADIUS)
    middle = wrist + _HAND_AHEAD * forward
    about_hand = (along > 0.8 * length) & (np.linalg.norm(scan.points - middle, axis=1) < _HAND_REACH)
    near = np.flatnonzero(on_forearm | about_hand)
    if not len(near):
        return None
    closest = SurfaceTree(posed.vertices, model.faces).closest(scan.points[near])
    own = np.zeros(model.vertex_count, dtype=bool)
    own[arm.vertices] = True
    kept = own[model.faces[closest.faces]].any(axis=1) | (closest.distances > _OTHERS)
    mask = np.zeros(len(scan.points), dtype=bool)
    mask[near[kept]] = True
    return scan.subset(mask) if (mask & (along > length)).sum() >= _FEWEST_POINTS else None


def _pose_of_arm(arm: _Arm, posed: Evaluated, pose: Float[np.ndarray, "K 3"]) -> ModelParameters:
    """The arm's own parameters: its root is the elbow, placed and turned as in the body."""
    own = pose[arm.joints].copy()
    own[0] = axis_angle_from_matrix(posed.T_world_joint[arm.joints[:1], :3, :3])[0]
    return ModelParameters(posed.joints[arm.joints[0]], own, np.zeros(0))


def _local_pose(
    model: SurfaceModel, arm: _Arm, posed: Evaluated, vector: Float[np.ndarray, " Q"]
) -> Float[np.ndarray, "j 3"]:
    """An arm's parameters as the body's pose of its joints: the elbow against the upper arm."""
    own = vector[3 : 3 + 3 * len(arm.joints)].reshape(-1, 3).copy()
    above = posed.T_world_joint[model.parents[arm.joints[0]], :3, :3]
    turned = evaluate(arm.part, np.zeros(arm.part.shape_count), own, np.zeros(3)).T_world_joint[0, :3, :3]
    own[0] = axis_angle_from_matrix((above.T @ turned)[None])[0]
    return own


def _cost(solution: Solution) -> float:
    """What tells which of two descents is better; one that broke is worse than any."""
    return solution.cost if solution.outcome.usable and np.isfinite(solution.cost) else np.inf


class _ArmFit:
    """One arm, in the shape of its person, being fitted to what was cut out of a scan."""

    def __init__(self, arm: _Arm, shape: Float[np.ndarray, " s"], scan: Scan, begun: ModelParameters) -> None:
        part = arm.part
        shaped = part.template + part.shape_directions[:, :, : len(shape)] @ shape
        rest = part.joint_regressor @ shaped
        hand = np.asarray(part.skinning_weights[:, 1:].sum(axis=1)).reshape(-1, 1)
        growth = _HAND_SIZE * hand * (shaped - rest[1])
        self._model = part.replace(template=shaped, shape_directions=growth[:, :, None])
        self._arm = arm
        self._fields = ModelFields(self._model, shape_count=1)
        self._coarse = ModelFields(self._model, shape_count=1, correctives=False)
        self._begun = ModelParameters(begun.translation - rest[0], begun.pose, np.zeros(1)).vector()
        self._points, self._normals = sample_surface(scan, _POINTS)
        self._scan: ScanSurface = ScanSurface.of_mesh(scan.points, scan.faces, SURFACE_POINTS)
        self._block = next(block for block in part.pose_blocks if len(block.components))
        self._where = block_columns(self._block, self._fields.columns)
        first = self._fields.columns.pose.start
        self._root, self._wrist = slice(first, first + 3), slice(first + 3, first + 6)

    def best_turn(
        self, fingers: tuple[Float[np.ndarray, " f"], ...] | None
    ) -> tuple[Float[np.ndarray, " Q"], HandTried]:
        """``best``; where that is a bad descent, the best from a turned forearm too, with all known fingers.

        A body's fit may take a palm for a back. In the right turn descents cost 150 to 350; in a wrong one no
        fingers made up for it, the best cost 955 where half of that was found behind the true turn.
        """
        found = self.best(fingers)
        if found[1].cost < _TURNED_FROM:
            return found
        turned = min((self._turned(turn).best(None) for turn in _TURNS), key=lambda one: one[1].cost)
        if turned[1].cost >= found[1].cost:
            return found
        return turned[0], replace(turned[1], cost_before=found[1].cost_before)

    def _turned(self, angle: float) -> _ArmFit:
        """The same fit begun with the forearm turned about itself, radians."""
        elbow, wrist = (self._arm.part.joint_regressor @ self._arm.part.template)[:2]
        along = (wrist - elbow) / np.linalg.norm(wrist - elbow)
        other = copy.copy(self)
        other._begun = self._begun.copy()
        root, turn = matrix_from_axis_angle(np.array([self._begun[self._root], angle * along]))
        other._begun[self._root] = axis_angle_from_matrix((root @ turn)[None])[0]
        return other

    def best(
        self, fingers: tuple[Float[np.ndarray, " f"], ...] | None
    ) -> tuple[Float[np.ndarray, " Q"], HandTried]:
        """The descent that costs least: from the own pose, or from ``fingers``, all known ones if None."""
        own = self._descended(self._begun, _FIRST, _WIDE, _NARROW)
        straight = self._begun.copy()
        straight[self._wrist] = 0
        bent = np.linalg.norm(self._begun[self._wrist]) > _STRAIGHT
        wrists = [self._begun, straight] if bent else [self._begun]
        known = self._known_fingers() if fingers is None else list(fingers)
        found, promising = self._best_of([self._posed(w, one) for w in wrists for one in known], own)
        kept = tuple(start[self._where] for start in promising)
        found, _ = self._best_of(self._other_thumbs(found.state.parameters), found)
        vector = found.state.parameters
        placed = self._fields.evaluated(vector).vertices
        hand = HandTried(self._block.name, found.cost, own.cost, self._arm.vertices, placed, kept)
        return vector, hand

    def _best_of(
        self, starts: list[Float[np.ndarray, " Q"]], other: Solution
    ) -> tuple[Solution, list[Float[np.ndarray, " Q"]]]:
        """All go two steps, the better ones the wide way, the best of them the narrow one too.

        Given back are the best of all and the starts of the better ones.
        """
        begun = sorted(
            ((self._descended(start, _FIRST), start) for start in starts), key=lambda it: _cost(it[0])
        )
        better = begun[:_GOING_ON]
        wide = sorted((self._descended(found.state.parameters, _WIDE) for found, _ in better), key=_cost)
        narrow = [self._descended(found.state.parameters, _WIDE, _NARROW) for found in wide[:_KEPT]]
        return min([other, *narrow], key=_cost), [start for _, start in better]

    def _known_fingers(self) -> list[Float[np.ndarray, " n"]]:
        """The flat hand, the middle of every known kind of pose, and the same bent more.

        Recorded kinds of poses end before the closed fist, whose start must be near.
        """
        mixture, limits = self._block.mixture, self._block.limits
        known = list(self._block.mean[None] if mixture is None else mixture.means)
        if limits is not None:
            numbers = limits.reshape(-1, 2)
            known += [np.clip(_BENT * one, *(_BENT_TO * numbers.T)) for one in known]
        return [np.zeros_like(self._block.mean), *known]

    def _posed(
        self, vector: Float[np.ndarray, " Q"], fingers: Float[np.ndarray, " n"]
    ) -> Float[np.ndarray, " Q"]:
        posed = vector.copy()
        posed[self._where] = fingers
        return posed

    def _other_thumbs(self, vector: Float[np.ndarray, " Q"]) -> list[Float[np.ndarray, " Q"]]:
        """The same with every known thumb: beside a fist or over it, a wrong one is in the fingers' way."""
        names = [self._model.joint_names[joint] for joint in self._block.joints]
        thumb = np.repeat(["thumb" in name for name in names], 3)
        own = vector[self._where]
        return [self._posed(vector, np.where(thumb, other, own)) for other in self._known_fingers()]

    def _descended(self, start: Float[np.ndarray, " Q"], *descents: _Descent) -> Solution:
        for descent in descents:
            fields = self._fields if descent.every == 1 else self._coarse
            problem = Problem(self._terms(descent), fields.derive, fields.differentiate)
            limits = DoglegOptions(iterations=descent.iterations, relative_decrease=1e-3)
            solution = solve(problem, State(start), limits)
            start = solution.state.parameters
        return solution

    def _terms(self, descent: _Descent) -> list[Term]:
        columns, arm = self._fields.columns, self._arm
        distance = DistanceOptions(descent.sigma, descent.robust_scale, _TANGENTIAL, _MINIMUM_COSINE)
        points, normals = self._points[:: descent.every], self._normals[:: descent.every]
        weights = np.full(len(points), _OBSERVATIONS / len(points))
        asked = np.flatnonzero(arm.fingers)[:: descent.every]
        back = np.zeros(len(arm.fingers))
        back[asked] = _BACK * _OBSERVATIONS / max(len(asked), 1)
        return [
            ScanToSurface("scan", MODEL, arm.surface, points, weights, normals, distance),
            SurfaceToScan("back", MODEL, arm.surface, self._scan, back, distance, True, STICKING_OUT),
            GaussianPrior.isotropic("elbow", columns.translation, self._begun[columns.translation], _ELBOW),
            GaussianPrior.isotropic("forearm", self._root, self._begun[self._root], _FOREARM),
            *prior_terms(
                self._model,
                columns,
                shape_sigma=1.0,
                pose_prior_scale=_PRIOR_SCALE,
                limit_sigma=_LIMIT_SIGMA,
            ),
        ]
