"""What a frame is fitted to: points sampled on its scan, and how much of a model they confirm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from corporeal.fitting.options import TrackingOptions
from corporeal.fitting.pose_terms import is_hand
from corporeal.geometry.closest_points import ClosestPoints
from corporeal.geometry.normals import areas_around, face_areas, face_normals
from corporeal.model.statistics import PoseBlock
from corporeal.model.surface_model import SurfaceModel
from corporeal.scans.scan import Scan
from corporeal.scans.surface_sampling import sample_surface
from corporeal.terms.scan_to_surface import MovingSurface
from corporeal.terms.surface_to_scan import ScanSurface

# A sample this near, on skin that faces the same way, confirms the surface beside it.
_BESIDE = 0.02
_SAME_SKIN = 0.3
# Where the mesh is finer than its mean by this, all points are taken.
_IN_DETAIL = 4.0


@dataclass(frozen=True, eq=False)
class FramePoints:
    """Points spread evenly over a scan's area.

    Attributes:
        positions: (n, 3) metres.
        normals: (n, 3) of unit length; None for a point cloud, whose normals are guessed.
        area_per_point: square metres that a point stands for; None for a point cloud.
    """

    positions: Float[np.ndarray, "n 3"]
    normals: Float[np.ndarray, "n 3"] | None
    area_per_point: float | None

    def some(self, which: Int[np.ndarray, " m"]) -> FramePoints:
        """Those of the given numbers."""
        normals = None if self.normals is None else self.normals[which]
        return FramePoints(self.positions[which], normals, self.area_per_point)


def frame_points(scan: Scan, options: TrackingOptions) -> FramePoints:
    """Sample a frame; the same points for the same scan."""
    positions, normals = sample_surface(scan, options.samples, seed=options.seed)
    if scan.is_point_cloud:
        return FramePoints(positions, None, None)
    area = float(face_areas(scan.points, scan.faces).sum())
    return FramePoints(positions, normals, area / len(positions))


@dataclass(frozen=True, eq=False)
class FrameData:
    """All that is kept of a frame's scan while others are fitted: 24 megabytes of a body's.

    Attributes:
        name: of the frame.
        points: spread over the scan.
        back: the scan's surface, for distances back; None for a point cloud.
    """

    name: str
    points: FramePoints
    back: ScanSurface | None


@dataclass(frozen=True, eq=False)
class HandFaces:
    """Faces of each hand of a model, by the joints that carry them.

    Attributes:
        masks: "left_hand" -> (F,).
        forearms: "left_forearm" -> (F,); none of a hand alone.
    """

    masks: dict[str, Bool[np.ndarray, " F"]]
    forearms: dict[str, Bool[np.ndarray, " F"]]

    @classmethod
    def of_model(cls, model: SurfaceModel) -> HandFaces:
        """A face is a hand's where the hand's joints carry most of its three vertices."""
        masks, forearms = {}, {}
        for block in model.pose_blocks:
            if not is_hand(block):
                continue
            masks[block.name] = _carried(model, block.joints)
            above = joints_above(model, block)
            if len(above) > 1:
                forearms[forearm_of(block.name)] = _carried(model, above[1:2])
        return cls(masks, forearms)

    def any_hand(self, count: int) -> Bool[np.ndarray, " F"]:
        """Faces of either hand, out of ``count``."""
        found = np.zeros(count, dtype=bool)
        for mask in self.masks.values():
            found |= mask
        return found


def joints_above(model: SurfaceModel, hand: PoseBlock) -> tuple[int, ...]:
    """Wrist, elbow, shoulder and so on of a hand's block, up to the root, which is left out."""
    joint, above = int(model.parents[hand.joints[0]]), []
    while joint > 0:
        above.append(joint)
        joint = int(model.parents[joint])
    return tuple(above)


def forearm_of(hand: str) -> str:
    """The name of a hand's forearm: "left_forearm" of "left_hand"."""
    return hand.removesuffix("hand") + "forearm"


def _carried(model: SurfaceModel, joints: Sequence[int]) -> Bool[np.ndarray, " F"]:
    mostly = model.skinning_weights[:, list(joints)].sum(axis=1) > 0.5
    return mostly[model.faces].sum(axis=1) >= 2


@dataclass(frozen=True, eq=False)
class PointShares:
    """How much points of a scan weigh, by the face of the model that they lie at.

    Attributes:
        weights: (F,) factors.
        in_detail: (F,) faces whose points are all taken; of the others some stand for all.
    """

    weights: Float[np.ndarray, " F"]
    in_detail: Bool[np.ndarray, " F"]

    @classmethod
    def of_model(
        cls, model: SurfaceModel, hands: Bool[np.ndarray, " F"], options: TrackingOptions
    ) -> PointShares:
        """Those of hands weigh what the options say; others 1, or as finely as the mesh is made there."""
        fineness = np.ones(len(model.faces))
        if options.weigh_by_fineness:
            areas = areas_around(model.template, model.faces)
            per_vertex = areas.mean() / np.maximum(areas, np.finfo(float).tiny)
            least = options.coarse_weight
            most = max(options.hand_weight, least)
            fineness = np.clip(per_vertex[model.faces].mean(axis=1), least, most)
        return cls(np.where(hands, options.hand_weight, fineness), hands | (fineness > _IN_DETAIL))


def chosen_points(
    closest: ClosestPoints, shares: PointShares,
    own: Float[np.ndarray, " n"], options: TrackingOptions,
) -> tuple[Int[np.ndarray, " m"], Float[np.ndarray, " m"]]:  # fmt: skip
    """Which points are fitted to, all on the parts in detail and some of the others, with weights.

    The others weigh more where they are fewer than could be taken, so that parts stay in proportion; those
    on hands less, as ``own`` says, where they may be another part's.
    """
    in_detail = shares.in_detail[closest.faces]
    others = np.flatnonzero(~in_detail)
    picked = others[: options.body_points]
    each = len(others) / max(len(picked), 1) * options.body_points / options.samples
    kept = np.concatenate([picked, np.flatnonzero(in_detail)])
    weights = (shares.weights[closest.faces] * own * np.where(in_detail, 1.0, each))[kept]
    return kept, weights


def confirmed(
    points: FramePoints, closest: ClosestPoints, vertices: Float[np.ndarray, "V 3"], surface: MovingSurface,
    beside: float = _BESIDE,
) -> Bool[np.ndarray, " n"]:  # fmt: skip
    """Points within 2 cm of the surface, or as ``beside`` says, on skin that faces the same way."""
    near = closest.distances < beside
    if points.normals is not None:
        own = face_normals(vertices, surface.faces)[closest.faces]
        near &= np.einsum("na,na->n", own, points.normals) > _SAME_SKIN
    return near


def seen_shares(
    points: FramePoints,
    closest: ClosestPoints,
    vertices: Float[np.ndarray, "V 3"],
    surface: MovingSurface,
    hands: HandFaces,
) -> dict[str, float]:
    """Share of the surface, each hand and forearm that scan points confirm, by area; 1 where all is seen.

    Of a point cloud, whose points stand for no area, the share of faces' area per point is that of the whole.
    """
    areas = face_areas(vertices, surface.faces)
    near = confirmed(points, closest, vertices, surface)
    per_point = points.area_per_point
    if per_point is None:
        per_point = float(areas.sum()) / len(points.positions)
    faces = closest.faces[near]
    shares = {"model_seen": _share(len(faces), per_point, float(areas.sum()))}
    for name, mask in (hands.masks | hands.forearms).items():
        shares[f"{name}_seen"] = _share(int(mask[faces].sum()), per_point, float(areas[mask].sum()))
    return shares


def _share(count: int, per_point: float, area: float) -> float:
    return min(count * per_point / max(area, 1e-30), 1.0)
