"""Fingers that have lost their scan, looked for among recorded poses: no descent leads from a fist to them.

Straight fingers of a scan are nearest to the knuckles of bent ones, and a thumb that has slipped off a fist
finds nothing in the air that would lead it back.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from corporeal.fitting.frame_data import joints_above
from corporeal.geometry.normals import face_normals
from corporeal.model.statistics import PoseBlock
from corporeal.model.surface_model import SurfaceModel
from corporeal.terms.model_fields import ModelFields
from corporeal.terms.scan_to_surface import MovingSurface
from corporeal.terms.surface_to_scan import ScanSurface

# Points so near to the hand's middle are asked, but not those so near to the rest of the body; metres.
_REACH, _ELSEWHERE = 0.13, 0.015
# What lies farther off counts no more, metres.
_FARTHEST = 0.03
# A smaller share of a body's points says nothing of a hand: with a third of it, fingers of fists of which a
# fifth was seen were laid elsewhere.
_FEWEST = 3e-3
# Root mean square distances of points and of what is outside of the scan: webs make up for 4 to 6 mm.
_LOST = 6e-3
# Where this share of a body's points is a hand's, it is open, and webs make up for 3 to 4 mm: two fingers in
# the place of one lay 5.2 mm off.
_MUCH, _LOST_IN_SIGHT = 6e-3, 4.5e-3
# Phalanges of two fingers, side by side, lie 14 mm apart and more between their middles; nearer, they are in
# one another, and each pair costs this part of the square that it is too near.
_APART, _OVERLAP = 0.012, 0.5
# Square metres, to divide by where a point lies on the hand and the rest at once, or all is explained.
_NOWHERE = 1e-12
# Root mean square depth of a hand in the rest of the body that no flesh gives way to.
_DEEP = 8e-3
# The part that the depth in the rest of the body has: with 1, fingers stretched into a thigh cost no more
# than a fist on it of which a quarter is seen.
_WITHIN = 3.0
# Degrees about the forearm by which a hand that is back may be turned otherwise.
_TURNS = (-45.0, 0.0, 45.0)
# So many poses go through solves where fingers are begun anew.
_ANEW = 3
# A search that leaves more than this share of the cost is not worth a solve.
_WORTH = 0.8
# Hands that had come back the wrong way round cost a tenth as much once they were righted; with the share
# above another was laid 20 mm off.
_WORTH_TURNING = 0.25


@dataclass(frozen=True, eq=False)
class LostFingers:
    """A hand that does not lie in its scan.

    Attributes:
        search: whose hand.
        points: of the scan that are the hand's, metres.
        cost: of the hand as it lies.
    """

    search: FingerSearch
    points: Float[np.ndarray, "n 3"]
    cost: float

    def sought(
        self, fields: ModelFields, vector: Float[np.ndarray, " Q"], scan: ScanSurface
    ) -> Float[np.ndarray, " Q"] | None:
        """The parameters with fingers where points and surface are much nearer to each other, or None.

        The best candidate stays, or what is as it is: of all fingers at once, then of one after the other.

        Args:
            fields: of the model.
            vector: parameters that fit; all but the fingers' stay.
            scan: its surface.
        """
        cost, found = self._better(fields, vector, self.cost, self.search.joints, scan)
        cost, found = self._finger_by_finger(fields, found, cost, scan)
        return found if cost < _WORTH * self.cost else None

    def anew(
        self, fields: ModelFields, vector: Float[np.ndarray, " Q"], scan: ScanSurface
    ) -> list[Float[np.ndarray, " Q"]]:
        """Parameters with all fingers begun anew, from the recorded poses that come nearest to the scan.

        For hands that nothing has followed yet: fingers that took each other's places fit a scan better than
        any recorded pose does, until that has gone through a solve of its own.

        Args:
            fields: of the model.
            vector: parameters that fit; all but the fingers' stay.
            scan: its surface.
        """
        joints = self.search.joints
        tried = [self._posed(fields, vector, candidate, joints, scan) for candidate in self.search.poses]
        nearest = sorted(tried, key=lambda one: one[0])[:_ANEW]
        return [self._finger_by_finger(fields, posed, cost, scan)[1] for cost, posed in nearest]

    def turned(
        self, fields: ModelFields, vector: Float[np.ndarray, " Q"], before: Float[np.ndarray, "K 3"]
    ) -> list[Float[np.ndarray, " Q"]]:
        """Parameters with the hand as it was before it was out of sight, and as it is, turned both ways.

        For hands that are back: how the forearm has been turned in between nobody saw, and a hand laid into
        its scan the wrong way round stays so.

        Args:
            fields: of the model.
            vector: parameters that fit; all but the fingers' and the wrist's stay.
            before: (K, 3) the last pose, radians.
        """
        wrist, forearm = self.search.wrist, self.search.forearm
        if wrist is None or forearm is None:
            return []
        joints = [wrist, *self.search.joints]
        begins = []
        for pose in (before, vector[fields.columns.pose].reshape(-1, 3)):
            for angle in _TURNS:
                begin = vector.copy()
                turns = begin[fields.columns.pose].reshape(-1, 3)
                turns[joints] = pose[joints]
                about = Rotation.from_rotvec(np.deg2rad(angle) * forearm)
                turns[wrist] = (about * Rotation.from_rotvec(pose[wrist])).as_rotvec()
                begins.append(begin)
        return begins

    def _finger_by_finger(
        self, fields: ModelFields, vector: Float[np.ndarray, " Q"], cost: float, scan: ScanSurface
    ) -> tuple[float, Float[np.ndarray, " Q"]]:
        for finger in self.search.fingers:
            cost, vector = self._better(fields, vector, cost, list(finger), scan)
        return cost, vector

    def _better(
        self, fields: ModelFields, vector: Float[np.ndarray, " Q"], cost: float, joints: list[int],
        scan: ScanSurface,
    ) -> tuple[float, Float[np.ndarray, " Q"]]:  # fmt: skip
        """The best of all candidates for some joints, and of the parameters as they are."""
        tried = (self._posed(fields, vector, candidate, joints, scan) for candidate in self.search.poses)
        return min([(cost, vector), *tried], key=lambda one: one[0])

    def _posed(
        self, fields: ModelFields, vector: Float[np.ndarray, " Q"], candidate: Float[np.ndarray, "K 3"],
        joints: list[int], scan: ScanSurface,
    ) -> tuple[float, Float[np.ndarray, " Q"]]:  # fmt: skip
        posed = vector.copy()
        posed[fields.columns.pose].reshape(-1, 3)[joints] = candidate[joints]
        return self.search.cost(fields.evaluated(posed).vertices, self.points, scan), posed

    def found(self, cost: float, *, turned: bool = False) -> bool:
        """Whether a cost is that of a surface which explains much more of the hand, or, turned, far more."""
        return cost < (_WORTH_TURNING if turned else _WORTH) * self.cost

    def cost_of(self, vertices: Float[np.ndarray, "V 3"], scan: ScanSurface) -> float:
        """What a posed surface leaves unexplained of the hand."""
        return self.search.cost(vertices, self.points, scan)


class Comparison(NamedTuple):
    """Of two posed surfaces, how a scan decides.

    Attributes:
        for_ones: logarithm of how many times as much the others leave unexplained.
        clear: whether the ones are clearly better, and the scan shows enough of the hand to say so alone.
    """

    for_ones: float
    clear: bool


@dataclass(frozen=True, eq=False)
class FingerSearch:
    """Recorded poses of the fingers of one hand.

    Attributes:
        hand: (V,) vertices of the hand.
        rest: the skin of all that neither the hand nor its forearm carries, which no finger goes into;
            None where there is none.
        phalanges: (15, V) shares of vertices in the middle of what each of the fingers' joints carries.
        fingers: joints of every finger, from the palm outwards.
        poses: (C, K, 3) candidates, radians, of the hand's joints: straight, and recorded ones.
        wrist: joint that the hand hangs on, and
        forearm: (3,) the direction that leads to it at the zero pose; None where the model has none.
    """

    hand: Bool[np.ndarray, " V"]
    rest: MovingSurface | None
    phalanges: sp.csr_matrix
    fingers: tuple[tuple[int, ...], ...]
    poses: Float[np.ndarray, "C K 3"]
    wrist: int | None = None
    forearm: Float[np.ndarray, "3"] | None = None

    @classmethod
    def of_block(cls, model: SurfaceModel, block: PoseBlock, faces: Bool[np.ndarray, " F"]) -> FingerSearch:
        """That of a hand's block and faces; the middles of recorded poses' clusters, where there are any."""
        fingers: list[list[int]] = []
        for joint in block.joints:
            parent = int(model.parents[joint])
            own = next((finger for finger in fingers if finger[-1] == parent), None)
            if own is None:
                fingers.append([joint])
            else:
                own.append(joint)
        recorded = block.mean[None] if block.mixture is None else block.mixture.means
        poses = np.zeros((1 + len(recorded), model.joint_count, 3))
        poses[1:, list(block.joints)] = recorded.reshape(len(recorded), -1, 3)
        hand = np.zeros(model.vertex_count, dtype=bool)
        hand[np.unique(model.faces[faces])] = True
        joints = [joint for finger in fingers for joint in finger]
        carried = (model.skinning_weights[:, joints] > 0.5).astype(float)
        phalanges = sp.csr_matrix((carried / np.maximum(carried.sum(axis=0), 1)).T)
        wrist, forearm = None, None
        above = joints_above(model, block)
        if len(above) > 1:
            places = model.joint_regressor @ model.template
            wrist, along = above[0], places[above[0]] - places[above[1]]
            forearm = along / np.linalg.norm(along)
        chains = tuple(map(tuple, fingers))
        return cls(hand, _rest(model, block, hand), phalanges, chains, poses, wrist, forearm)

    @property
    def joints(self) -> list[int]:
        """Of all fingers."""
        return [joint for finger in self.fingers for joint in finger]

    def lost(
        self, vertices: Float[np.ndarray, "V 3"], points: Float[np.ndarray, "n 3"], scan: ScanSurface,
        *, however_little: bool = False,
    ) -> LostFingers | None:  # fmt: skip
        """What a posed hand leaves unexplained; None where all is well, or too little is seen of it.

        Args:
            vertices: of the posed model.
            points: of the frame, metres.
            scan: its surface.
            however_little: whether it matters how much is seen.
        """
        own = self._own(vertices, points)
        little = len(own) < _FEWEST * len(points) and not however_little
        if not len(own) or (little and self._within(vertices) <= _DEEP**2):
            return None
        cost = self.cost(vertices, own, scan)
        limit = _LOST if len(own) < _MUCH * len(points) else _LOST_IN_SIGHT
        return LostFingers(self, own, cost) if cost > limit**2 else None

    def compared(
        self, ones: Float[np.ndarray, "V 3"], others: Float[np.ndarray, "V 3"],
        points: Float[np.ndarray, "n 3"], scan: ScanSurface | None,
    ) -> Comparison:  # fmt: skip
        """Which of two posed surfaces explains the hand's points better.

        What the rest of the body explains well enough costs neither: a thumb that had been drawn out to a
        thigh, which lay a centimetre off its model, was better there than the true one.
        """
        own = np.unique(np.concatenate([self._own(ones, points), self._own(others, points)]), axis=0)
        if scan is None or not len(own):
            return Comparison(0.0, False)
        one, other = (
            self.cost(vertices, own, scan, self._beyond_rest(vertices, own)) + _NOWHERE
            for vertices in (ones, others)
        )
        enough = len(own) >= _FEWEST * len(points) and self._within(others) <= _DEEP**2
        return Comparison(float(np.log(other / one)), enough and one < _WORTH * other)

    def own_shares(
        self, vertices: Float[np.ndarray, "V 3"], points: Float[np.ndarray, "n 3"],
        distances: Float[np.ndarray, " n"],
    ) -> Float[np.ndarray, " n"]:  # fmt: skip
        """How surely points nearest to the hand are the hand's, and not the thigh's that it passes: 0 to 1.

        Where another person's thigh lies a centimetre off its model, thumbs were drawn out to it.

        Args:
            vertices: of the posed model.
            points: nearest to the hand, metres.
            distances: from it, metres.
        """
        if self.rest is None or not len(points):
            return np.ones(len(points))
        to_rest = self.rest.closest(vertices, points, None).distances ** 2
        return to_rest / np.maximum(to_rest + distances**2, _NOWHERE)

    def _own(self, vertices: Float[np.ndarray, "V 3"], points: Float[np.ndarray, "n 3"]) -> np.ndarray:
        """Points about the hand that the rest of the body does not explain."""
        middle = vertices[self.hand].mean(axis=0)
        about = points[np.linalg.norm(points - middle, axis=1) < _REACH]
        others = vertices[~self.hand]
        others = others[np.linalg.norm(others - middle, axis=1) < _REACH + _ELSEWHERE]
        if not len(others) or not len(about):
            return about
        to_hand, to_others = (cKDTree(part).query(about)[0] for part in (vertices[self.hand], others))
        return about[to_others > np.maximum(to_hand, _ELSEWHERE)]

    def _beyond_rest(
        self, vertices: Float[np.ndarray, "V 3"], points: Float[np.ndarray, "n 3"]
    ) -> Float[np.ndarray, " n"]:
        """How much farther points lie from the rest of the body than its own skin may, metres."""
        others = vertices[~self.hand]
        if not len(others):
            return np.full(len(points), _FARTHEST)
        away, _ = cKDTree(others).query(points)
        return np.maximum(away - _ELSEWHERE, 0)

    def cost(
        self, vertices: Float[np.ndarray, "V 3"], points: Float[np.ndarray, "n 3"], scan: ScanSurface,
        most: Float[np.ndarray, " n"] | float = _FARTHEST,
    ) -> float:  # fmt: skip
        """Mean square distances of points to the hand, and of what of it is outside of the scan; overlaps.

        Those are of fingers with each other, and of the hand with the rest of the body. No point costs more
        than ``most``, metres.
        """
        hand = vertices[self.hand]
        away, _ = cKDTree(hand).query(points, distance_upper_bound=_FARTHEST)
        away = np.minimum(np.minimum(away, _FARTHEST), most)
        closest = scan.tree.closest(hand)
        outside = np.einsum("va,va->v", hand - closest.points, scan.normals[closest.faces]) > 0
        out = np.where(outside, np.minimum(closest.distances, _FARTHEST), 0.0)
        square = np.square(away).mean() + np.square(out).mean()
        return float(square + _WITHIN * self._within(vertices) + _OVERLAP * self._overlap(vertices))

    def _within(self, vertices: Float[np.ndarray, "V 3"]) -> float:
        """Mean square depth of the hand's vertices in the rest of the body."""
        if self.rest is None:
            return 0.0
        hand = vertices[self.hand]
        closest = self.rest.closest(vertices, hand, None)
        normals = face_normals(vertices, self.rest.faces)[closest.faces]
        inside = np.einsum("va,va->v", hand - closest.points, normals) < 0
        inside &= ~self.rest.at_boundary(closest)
        return float(np.square(np.where(inside, np.minimum(closest.distances, _FARTHEST), 0.0)).mean())

    def _overlap(self, vertices: Float[np.ndarray, "V 3"]) -> float:
        """Sum of squares by which phalanges of two fingers are too near."""
        middles = self.phalanges @ vertices
        finger = np.repeat(np.arange(len(self.fingers)), [len(finger) for finger in self.fingers])
        one, two = np.nonzero(finger[:, None] < finger)
        near = _APART - np.linalg.norm(middles[one] - middles[two], axis=1)
        return float(np.square(np.maximum(near, 0)).sum())


def _rest(model: SurfaceModel, block: PoseBlock, hand: Bool[np.ndarray, " V"]) -> MovingSurface | None:
    """The skin of all but a hand and its forearm."""
    arm = hand | (model.skinning_weights[:, list(joints_above(model, block)[:2])].sum(axis=1) > 0.1)
    faces = model.faces[~arm[model.faces].any(axis=1)]
    return MovingSurface(model.template, faces) if len(faces) else None
