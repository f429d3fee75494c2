"""Fingers that have lost their scan, looked for among recorded poses: no descent leads from a fist to them.

Straight fingers of a scan are nearest to the knuckles of bent ones, and a thumb that has slipped off a fist
finds nothing in the air that would lead it back.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree

from corporeal.model.statistics import PoseBlock
from corporeal.model.surface_model import SurfaceModel
from corporeal.terms.model_fields import ModelFields
from corporeal.terms.surface_to_scan import ScanSurface

# Points so near to the hand's middle are asked, but not those so near to the rest of the body; metres.
_REACH, _ELSEWHERE = 0.13, 0.015
# What lies farther off counts no more, metres.
_FARTHEST = 0.03
# Fewer points say nothing of a hand: with 20, fingers of fists of which a fifth was seen were laid elsewhere.
_FEWEST = 50
# Root mean square distances of points and of what is outside of the scan: webs make up for 4 to 6 mm.
_LOST = 6e-3
# Phalanges of two fingers, side by side, lie 14 mm apart and more between their middles; nearer, they are in
# one another, and each pair costs this part of the square that it is too near.
_APART, _OVERLAP = 0.012, 0.5
# A search that leaves more than this share of the cost is not worth a solve.
_WORTH = 0.8


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
        best, found, fingers = self.cost, vector, [list(finger) for finger in self.search.fingers]
        for joints in ([joint for finger in fingers for joint in finger], *fingers):
            start = found
            for candidate in self.search.poses:
                posed = start.copy()
                posed[fields.columns.pose].reshape(-1, 3)[joints] = candidate[joints]
                cost = self.search.cost(fields.evaluated(posed).vertices, self.points, scan)
                if cost < best:
                    best, found = cost, posed
        return found if best < _WORTH * self.cost else None

    def found(self, vertices: Float[np.ndarray, "V 3"], scan: ScanSurface) -> bool:
        """Whether a posed surface explains much more of the hand."""
        return self.search.cost(vertices, self.points, scan) < _WORTH * self.cost


@dataclass(frozen=True, eq=False)
class FingerSearch:
    """Recorded poses of the fingers of one hand.

    Attributes:
        hand: (V,) vertices of the hand.
        phalanges: (15, V) shares of vertices in the middle of what each of the fingers' joints carries.
        fingers: joints of every finger, from the palm outwards.
        poses: (C, K, 3) candidates, radians, of the hand's joints: straight, and recorded ones.
    """

    hand: Bool[np.ndarray, " V"]
    phalanges: sp.csr_matrix
    fingers: tuple[tuple[int, ...], ...]
    poses: Float[np.ndarray, "C K 3"]

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
        return cls(hand, phalanges, tuple(map(tuple, fingers)), poses)

    def lost(
        self, vertices: Float[np.ndarray, "V 3"], points: Float[np.ndarray, "n 3"], scan: ScanSurface
    ) -> LostFingers | None:
        """What a posed hand leaves unexplained; None where all is well, or too little is seen of it."""
        own = self._own(vertices, points)
        if len(own) < _FEWEST:
            return None
        cost = self.cost(vertices, own, scan)
        return LostFingers(self, own, cost) if cost > _LOST**2 else None

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

    def cost(
        self, vertices: Float[np.ndarray, "V 3"], points: Float[np.ndarray, "n 3"], scan: ScanSurface
    ) -> float:
        """Mean square distances of points to the hand and of what of it is outside of the scan; overlaps."""
        hand = vertices[self.hand]
        away, _ = cKDTree(hand).query(points, distance_upper_bound=_FARTHEST)
        closest = scan.tree.closest(hand)
        outside = np.einsum("va,va->v", hand - closest.points, scan.normals[closest.faces]) > 0
        out = np.where(outside, np.minimum(closest.distances, _FARTHEST), 0.0)
        square = np.square(np.minimum(away, _FARTHEST)).mean() + np.square(out).mean()
        return float(square + _OVERLAP * self._overlap(vertices))

    def _overlap(self, vertices: Float[np.ndarray, "V 3"]) -> float:
        """Sum of squares by which phalanges of two fingers are too near."""
        middles = self.phalanges @ vertices
        finger = np.repeat(np.arange(len(self.fingers)), [len(finger) for finger in self.fingers])
        one, two = np.nonzero(finger[:, None] < finger)
        near = _APART - np.linalg.norm(middles[one] - middles[two], axis=1)
        return float(np.square(np.maximum(near, 0)).sum())
