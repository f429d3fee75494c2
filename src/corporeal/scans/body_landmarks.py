"""Landmarks of a raw body scan with no manual step: virtual cameras, a 2D detector, robust triangulation.

The body first, from a ring of views round the axis in which a person is seen upright; then each hand in a
crop of its own, by the detector of hands.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from corporeal.geometry.cameras import Pinhole
from corporeal.geometry.triangulation import Triangulation, reprojection, robust_triangulation
from corporeal.scans.body_detector import BODY_NAMES, LEFT_RIGHT, BodyDetector
from corporeal.scans.detector import LANDMARK_NAMES, HandDetector
from corporeal.scans.landmarks import find_hand_landmarks
from corporeal.scans.scan import Scan
from corporeal.scans.virtual_cameras import (
    Subject,
    cameras_around,
    ring,
    spread_in_metres,
    upright_candidates,
)

# The detector's network takes 256 pixels.
_SIZE = 384
_FILL = 0.85
# A view agrees when half of its landmarks lie within this share of the picture.
_TOLERANCE_COARSE, _TOLERANCE_FINE = 0.05, 0.03
_COARSE_VIEWS, _FEWEST_COARSE, _UPRIGHT = 6, 3, 0.5
_FINE_VIEWS, _FINE_TILTS = 8, (-15.0, 20.0)
_FEWEST_VIEWS = 4
# Of the landmarks of the middle, not of one side: where these are upright the person is.
_NOSE = BODY_NAMES.index("nose")
_HIPS = [BODY_NAMES.index("left_hip"), BODY_NAMES.index("right_hip")]
# What is cut out round a hand: from its wrist's and knuckles' middle, metres; and how far the wrist of the
# two detectors may differ, or the hand was another one.
_HAND_REACH, _WRISTS_APART = 0.16, 0.08
_FEWEST_HAND_POINTS = 200


@dataclass(frozen=True, eq=False)
class BodyLandmarks:
    """What the views agree on, or why they do not.

    Attributes:
        ok: whether the landmarks may be used; ``reason`` says why not.
        names: MediaPipe's 33, then those of the hands that were found, as "left_hand_wrist".
        points: (N, 3) metres, in the scan's frame.
        spread_m: (N,) how far the views disagree about each point, metres.
        views_used: how many views agreed, of ``views_tried``.
        hands: sides whose hand was found.
    """

    ok: bool
    reason: str
    names: tuple[str, ...] = ()
    points: Float[np.ndarray, "N 3"] = field(default_factory=lambda: np.zeros((0, 3)))
    spread_m: Float[np.ndarray, " N"] = field(default_factory=lambda: np.zeros(0))
    views_used: int = 0
    views_tried: int = 0
    hands: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class _Views:
    """Cameras that saw a person, and the landmarks (C, 33, 2) that they saw."""

    cameras: list[Pinhole]
    pixels: Float[np.ndarray, "C 33 2"]
    tried: int

    def triangulated(self, tolerance: float) -> Triangulation | None:
        """Consensus; views that took the back for the front are turned round and asked again."""
        if len(self.cameras) < 2:
            return None
        projections = np.array([camera.projection for camera in self.cameras])
        first = robust_triangulation(projections, self.pixels, tolerance * _SIZE)
        if first is None:
            return None
        turned = self.pixels[:, LEFT_RIGHT]
        off = [np.median(reprojection(projections, p, first.points), axis=1) for p in (self.pixels, turned)]
        better = (off[1] < off[0])[:, None, None]
        return robust_triangulation(projections, np.where(better, turned, self.pixels), tolerance * _SIZE)


def find_body_landmarks(scan: Scan, bodies: BodyDetector, hands: HandDetector) -> BodyLandmarks:
    """Find the landmarks of the one person in a scan, in whatever direction it stands.

    Args:
        scan: mesh or point cloud, in metres.
        bodies: detector of people.
        hands: detector of hands.
    """
    subject = Subject.of_scan(scan)
    upright, best, tried = None, (0, 0.0), 0
    for up in upright_candidates(subject.outline):
        views = _seen(subject, ring(up, _COARSE_VIEWS, (0.0,)), up, bodies)
        tried += views.tried
        found = views.triangulated(_TOLERANCE_COARSE)
        if found is None:
            continue
        agree, stands = int(found.agreeing.sum()), _stands(found.points, up)
        if agree >= _FEWEST_COARSE and stands > 0 and (agree, stands) > best:
            upright, best = up, (agree, stands)
        # People who lie across the axis are seen as well, half as accurately.
        if agree >= _COARSE_VIEWS - 1 and stands > _UPRIGHT:
            break
    if upright is None:
        return BodyLandmarks(False, f"the detector saw no person in {tried} views", views_tried=tried)
    directions = ring(upright, _FINE_VIEWS, tuple(np.deg2rad(_FINE_TILTS)))
    fine = _seen(subject, directions, upright, bodies)
    tried += fine.tried
    result = fine.triangulated(_TOLERANCE_FINE)
    agree = 0 if result is None else int(result.agreeing.sum())
    if result is None or agree < _FEWEST_VIEWS:
        reason = f"virtual views disagree about the person ({agree} of {fine.tried} agree)"
        return BodyLandmarks(False, reason, views_tried=tried)
    return _with_hands(scan, fine, result, tried, hands)


def _stands(points: Float[np.ndarray, "33 3"], up: Float[np.ndarray, "3"]) -> float:
    """Cosine between the trunk and what is taken for up."""
    trunk = points[_NOSE] - points[_HIPS].mean(0)
    return float(trunk @ up / max(float(np.linalg.norm(trunk)), 1e-9))


def _seen(
    subject: Subject, directions: Float[np.ndarray, "C 3"], up: Float[np.ndarray, "3"], detector: BodyDetector
) -> _Views:
    cameras = cameras_around(subject.outline, directions, up, size=_SIZE, fill=_FILL)
    kept, pixels = [], []
    for camera in cameras:
        body = detector.detect(subject.picture(camera))
        if body is not None:
            kept.append(camera)
            pixels.append(body.pixels)
    return _Views(kept, np.array(pixels).reshape(-1, len(BODY_NAMES), 2), len(cameras))


def _with_hands(
    scan: Scan, views: _Views, result: Triangulation, tried: int, detector: HandDetector
) -> BodyLandmarks:
    names, points = list(BODY_NAMES), [result.points]
    spreads, sides = [spread_in_metres(views.cameras, result)], []
    for side in ("left", "right"):
        found = _hand(scan, result.points, side, detector)
        if found is None:
            continue
        sides.append(side)
        names += [f"{side}_hand_{name}" for name in LANDMARK_NAMES]
        points.append(found[0])
        spreads.append(found[1])
    return BodyLandmarks(
        ok=True,
        reason="views agree",
        names=tuple(names),
        points=np.concatenate(points),
        spread_m=np.concatenate(spreads),
        views_used=int(result.agreeing.sum()),
        views_tried=tried,
        hands=tuple(sides),
    )


def _hand(
    scan: Scan, body: Float[np.ndarray, "33 3"], side: str, detector: HandDetector
) -> tuple[np.ndarray, np.ndarray] | None:
    """Landmarks (21, 3) and spreads (21,) of one hand, seen in a crop; None where they are not sure."""
    wrist = body[BODY_NAMES.index(f"{side}_wrist")]
    elbow = body[BODY_NAMES.index(f"{side}_elbow")]
    knuckles = body[[BODY_NAMES.index(f"{side}_{finger}") for finger in ("pinky", "index", "thumb")]]
    centre = (wrist + knuckles.sum(0)) / 4
    forearm = (wrist - elbow) / max(float(np.linalg.norm(wrist - elbow)), 1e-6)
    near = np.linalg.norm(scan.points - centre, axis=1) < _HAND_REACH
    # A hand that hangs beside a thigh: what lies behind the wrist, towards the elbow, is no hand.
    near &= (scan.points - wrist) @ forearm > -0.08
    if near.sum() < _FEWEST_HAND_POINTS:
        return None
    found = find_hand_landmarks(scan.subset(near), detector)
    of_side = found.side_score if side == "right" else 1 - found.side_score
    if not found.ok or of_side < 0.5 or np.linalg.norm(found.points[0] - wrist) > _WRISTS_APART:
        return None
    return found.points, found.spread_m
