"""Fingers that have lost their scan, looked for among recorded poses: no descent leads from a fist to them.

Straight fingers of a scan are nearest to the knuckles of bent ones, and a thumb that has slipped off a fist
finds nothing in the air that would lead it back.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree

from corporeal.fitting.frame_data import HandFaces
from corporeal.model.statistics import PoseBlock
from corporeal.model.surface_model import SurfaceModel
from corporeal.terms.model_fields import ModelFields
from corporeal.terms.surface_to_scan import ScanSurface

# Points so near to the hand's middle are asked, but not those so near to the rest of the body; metres.
_REACH, _ELSEWHERE = 0.13, 0.015
# What lies farther off counts no more, metres.
_FARTHEST = 0.03
# Fewer points say nothing of a hand.
_FEWEST = 20
# Root mean square distances of points and of what is outside of the scan: webs make up for 4 to 6 mm.
_LOST = 6e-3
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

        Finger by finger the best candidate stays, or the finger as it is.

        Args:
            fields: of the model.
            vector: parameters that fit; all but the fingers' stay.
            scan: its surface.
        """
        best, found = self.cost, vector
        for finger in map(list, self.search.fingers):
            start = found
            for candidate in self.search.poses:
                posed = start.copy()
                posed[fields.columns.pose].reshape(-1, 3)[finger] = candidate[finger]
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
        fingers: joints of every finger, from the palm outwards.
        poses: (C, K, 3) candidates, radians, of the hand's joints: straight, and recorded ones.
    """

    hand: Bool[np.ndarray, " V"]
    fingers: tuple[tuple[int, ...], ...]
    poses: Float[np.ndarray, "C K 3"]

    @classmethod
    def of_block(cls, model: SurfaceModel, block: PoseBlock) -> FingerSearch:
        """That of a hand's block; the middles of the recorded poses' clusters, where there are any."""
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
        hand[np.unique(model.faces[HandFaces.of_model(model).masks[block.name]])] = True
        return cls(hand, tuple(map(tuple, fingers)), poses)

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
        """Mean square distance of points to the hand, and of what of the hand is outside of the scan."""
        hand = vertices[self.hand]
        away, _ = cKDTree(hand).query(points, distance_upper_bound=_FARTHEST)
        closest = scan.tree.closest(hand)
        outside = np.einsum("va,va->v", hand - closest.points, scan.normals[closest.faces]) > 0
        out = np.where(outside, np.minimum(closest.distances, _FARTHEST), 0.0)
        return float(np.square(np.minimum(away, _FARTHEST)).mean() + np.square(out).mean())
