"""Landmarks of a raw hand scan with no manual step: virtual cameras, a 2D detector, robust triangulation."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from corporeal.geometry.cameras import Pinhole
from corporeal.geometry.triangulation import Triangulation
from corporeal.scans.detector import LANDMARK_NAMES, DetectedHand, HandDetector
from corporeal.scans.scan import Scan
from corporeal.scans.virtual_cameras import Subject, cameras_around, ring, spread_in_metres, triangulated

# The detector's networks take 192 and 224 pixels: at 320 it was no better, and drawing took twice as long.
_SIZE = 224
# A view agrees when half of its landmarks lie within this share of the picture.
_TOLERANCE_COARSE, _TOLERANCE_FINE = 0.05, 0.025
_FEWEST_VIEWS = 4
_FEWEST_COARSE = 3
# Of the twelve coarse views round one end, those taken first.
_FLAT_VIEWS = 3
# With a smaller share, a mesh is looked at again without its noise; clean scans of closed hands reach 1/3.
_SHARE_TO_TRUST = 0.12
# Rounds of views on either side of the hand: turns about the fingers' direction and tilts along it, degrees,
# and how many views of all rounds so far have to agree to be done. A hand that is seen well needs 8 views.
# On 80 scans of a session landmarks are 6.0 mm off in the mean, after 23 pictures. With every picture looked
# at alone it was 6.4 mm after 32; so, with 20 views for a hand seen well and four flat ones, 6.3 mm after 47.
_ROUNDS: tuple[tuple[tuple[float, ...], tuple[float, ...], float], ...] = (
    ((-20.0, 20.0), (-10.0, 20.0), 6),
    ((-35.0, 0.0, 35.0), (-15.0, 20.0), 8),
    ((-40.0, -15.0, 15.0, 40.0), (-20.0, 5.0, 30.0), 8),
    ((-50.0, -10.0, 30.0), (-25.0, -5.0, 15.0, 35.0), np.inf),
)
# A hand with its wrist is about this long (metres); scans with an unknown unit come provisionally hand-sized.
_HAND_LENGTH = 0.22


@dataclass(frozen=True, eq=False)
class HandLandmarks:
    """What the views agree on, or why they do not.

    Attributes:
        ok: whether the landmarks may be used; ``reason`` says why not.
        names: of the landmarks, MediaPipe's order.
        points: (21, 3) metres, in the scan's frame.
        spread_m: (21,) how far the views disagree about each point, metres.
        side_score: probability of a right hand.
        views_used: how many views agreed, of ``views_tried``.
        reprojection_px: median residual of the agreeing views.
    """

    ok: bool
    reason: str
    names: tuple[str, ...] = LANDMARK_NAMES
    points: Float[np.ndarray, "21 3"] = field(default_factory=lambda: np.full((21, 3), np.nan))
    spread_m: Float[np.ndarray, " 21"] = field(default_factory=lambda: np.full(21, np.nan))
    side_score: float = 0.5
    views_used: int = 0
    views_tried: int = 0
    reprojection_px: float = float("nan")


@dataclass(frozen=True, eq=False)
class _Views:
    """Cameras that saw a hand, and what they saw."""

    cameras: list[Pinhole]
    hands: list[DetectedHand]

    @classmethod
    def of(cls, cameras: list[Pinhole], seen: list[DetectedHand | None]) -> _Views:
        """Those of the cameras that saw one."""
        pairs = [(camera, hand) for camera, hand in zip(cameras, seen, strict=True) if hand is not None]
        return cls([camera for camera, _ in pairs], [hand for _, hand in pairs])

    def joined(self, others: _Views) -> _Views:
        return _Views(self.cameras + others.cameras, self.hands + others.hands)

    def triangulated(self, tolerance: float) -> Triangulation | None:
        pixels = np.array([hand.pixels for hand in self.hands]).reshape(-1, len(LANDMARK_NAMES), 2)
        return triangulated(self.cameras, pixels, tolerance * _SIZE)


def find_hand_landmarks(scan: Scan, detector: HandDetector | None = None) -> HandLandmarks:
    """Find the 21 landmarks and the side of the one hand in a scan.

    A coarse ring looks at both ends of the scan's long axis (an arm may hang on the hand), its flat sides
    first; then finer views frame the hand that was found, from palm and back. Both stop early where the
    views agree: 14 views instead of 92.

    Args:
        scan: mesh or point cloud, in metres (a provisional scale will do).
        detector: one that is loaded already, or None to load it here.

    Raises:
        DetectorMissingError: mediapipe is not installed.
    """
    if detector is None:
        with HandDetector() as own:
            return find_hand_landmarks(scan, own)
    subject = Subject.of_scan(scan)
    found = _found_on(subject, detector)
    if found.views_used >= _SHARE_TO_TRUST * found.views_tried or scan.is_point_cloud:
        return found
    again = _found_on(subject.smoothed(), detector)
    tried = found.views_tried + again.views_tried
    return replace(again if again.views_used > found.views_used else found, views_tried=tried)


def _found_on(subject: Subject, detector: HandDetector) -> HandLandmarks:
    coarse, tried = _coarse_views(subject, detector)
    rough = coarse.triangulated(_TOLERANCE_COARSE)
    if rough is None or rough.agreeing.sum() < _FEWEST_COARSE:
        seen = len(coarse.cameras)
        reason = f"the detector saw no hand that views agree on ({seen} of {tried} views)"
        return HandLandmarks(False, reason, views_tried=tried)
    fine, result, agree = _Views([], []), rough, 0
    # Frames set by rough landmarks differ between turned copies of one scan, and the detector's answers with
    # them; every round frames what the last one found.
    for turns, tilts, enough in _ROUNDS:
        cameras = _fine_cameras(subject.outline, result.points, turns, tilts)
        tried += len(cameras)
        fine = fine.joined(_followed(subject, cameras, detector))
        found = fine.triangulated(_TOLERANCE_FINE)
        agree = 0 if found is None else int(found.agreeing.sum())
        if found is not None and agree >= _FEWEST_VIEWS:
            result = found
        if agree >= enough:
            break
    if agree < _FEWEST_VIEWS:
        reason = f"virtual views disagree about the hand ({agree} of {tried} agree)"
        return HandLandmarks(False, reason, views_tried=tried)
    return _landmarks(fine, result, tried)


def _coarse_views(subject: Subject, detector: HandDetector) -> tuple[_Views, int]:
    """Views round both ends of the long axis; those on the flat sides of an end may do."""
    points = subject.outline
    centred = points - points.mean(0)
    axis = np.linalg.eigh(centred.T @ centred)[1][:, 2]
    along = points @ axis
    first: list[Pinhole] = []
    others: list[Pinhole] = []
    for sign in (1.0, -1.0):
        end = points[sign * along > (sign * along).max() - _HAND_LENGTH]
        directions = ring(sign * axis, 12, (0.0,))
        cameras = cameras_around(end, directions, sign * axis, size=_SIZE, fill=0.75)
        offsets = end - end.mean(0)
        thin = np.linalg.eigh(offsets.T @ offsets)[1][:, 0]
        flat = set(np.argsort(-np.abs(directions @ thin), kind="stable")[:_FLAT_VIEWS].tolist())
        first += [camera for place, camera in enumerate(cameras) if place in flat]
        others += [camera for place, camera in enumerate(cameras) if place not in flat]
    views = _seen(subject, first, detector)
    rough = views.triangulated(_TOLERANCE_COARSE)
    if rough is not None and rough.agreeing.sum() >= _FEWEST_COARSE:
        return views, len(first)
    return views.joined(_seen(subject, others, detector)), len(first) + len(others)


def _fine_cameras(
    points: Float[np.ndarray, "N 3"],
    rough: Float[np.ndarray, "21 3"],
    turns: tuple[float, ...],
    tilts: tuple[float, ...],
) -> list[Pinhole]:
    """Views on palm and back that frame the landmarks found, fingers up."""
    fingers = rough[9] - rough[0]
    across = rough[5] - rough[17]
    fingers, across = fingers / np.linalg.norm(fingers), across / np.linalg.norm(across)
    normal = np.cross(fingers, across)
    normal /= np.linalg.norm(normal)
    directions = []
    for facing in (normal, -normal):
        for turn in np.deg2rad(turns):
            for tilt in np.deg2rad(tilts):
                flat = np.cos(turn) * facing + np.sin(turn) * np.cross(fingers, facing)
                directions.append(np.cos(tilt) * flat + np.sin(tilt) * fingers)
    size = np.linalg.norm(rough - rough.mean(0), axis=1).max()
    near = points[np.linalg.norm(points - rough.mean(0), axis=1) < 1.15 * size]
    framed = near if len(near) > 10 else rough
    return cameras_around(framed, np.array(directions), fingers, size=_SIZE, fill=0.7)


def _seen(subject: Subject, cameras: list[Pinhole], detector: HandDetector) -> _Views:
    return _Views.of(cameras, [detector.detect(subject.picture(camera)) for camera in cameras])


def _followed(subject: Subject, cameras: list[Pinhole], detector: HandDetector) -> _Views:
    """Of cameras that frame a hand alike; those that see it are more than when each is looked at alone."""
    return _Views.of(cameras, detector.followed([subject.picture(camera) for camera in cameras]))


def _landmarks(views: _Views, result: Triangulation, tried: int) -> HandLandmarks:
    used = np.flatnonzero(result.agreeing)
    odds = [views.hands[c].right_probability for c in used]
    return HandLandmarks(
        ok=True,
        reason="views agree",
        points=result.points,
        spread_m=spread_in_metres(views.cameras, result),
        side_score=float(np.mean(odds)),
        views_used=len(used),
        views_tried=tried,
        reprojection_px=float(np.median(result.residuals[used])),
    )
