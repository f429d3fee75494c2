"""Landmarks of a raw head scan with no manual step: virtual cameras, a 2D detector, robust triangulation."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from corporeal.geometry.cameras import Pinhole
from corporeal.scans.face_detector import FACE_NAMES, FaceDetector
from corporeal.scans.scan import Scan
from corporeal.scans.virtual_cameras import (
    Subject,
    cameras_around,
    ring,
    spread_in_metres,
    triangulated,
    upright_candidates,
)

_SIZE = 320
# A view agrees when half of its landmarks lie within this share of the picture.
_TOLERANCE_COARSE, _TOLERANCE_FINE = 0.04, 0.02
_COARSE_VIEWS, _FEWEST_COARSE, _FEWEST_VIEWS, _FILL_COARSE = 12, 3, 5, 0.9
# Turns about the head's axis and tilts from the face's front, degrees.
_TURNS, _TILTS = (-36.0, -18.0, 0.0, 18.0, 36.0), (-14.0, 4.0, 20.0)
# What is framed then: so many times the landmarks' greatest distance from their middle.
_REACH = 1.7
_BROWS = [FACE_NAMES.index(f"{side}_brow_{k}") for side in ("left", "right") for k in (1, 3, 5)]
_LIPS = [FACE_NAMES.index(name) for name in ("lip_top", "lip_bottom", "nose_base")]
_CORNERS = [FACE_NAMES.index(f"{side}_eye_outer") for side in ("left", "right")]


@dataclass(frozen=True, eq=False)
class FaceLandmarks:
    """What the views agree on, or why they do not.

    Attributes:
        ok: whether the landmarks may be used; ``reason`` says why not.
        names: of the landmarks.
        points: (51, 3) metres, in the scan's frame.
        spread_m: (51,) how far the views disagree about each point, metres.
        views_used: how many views agreed, of ``views_tried``.
    """

    ok: bool
    reason: str
    names: tuple[str, ...] = FACE_NAMES
    points: Float[np.ndarray, "51 3"] = field(default_factory=lambda: np.full((51, 3), np.nan))
    spread_m: Float[np.ndarray, " 51"] = field(default_factory=lambda: np.full(51, np.nan))
    views_used: int = 0
    views_tried: int = 0


def find_face_landmarks(scan: Scan, detector: FaceDetector) -> FaceLandmarks:
    """Find the landmarks of the one face in a scan, in whatever direction it looks.

    A ring of views round each axis that may be up; where one sees a face, finer ones frame it.

    Args:
        scan: mesh or point cloud of a head or bust, in metres (a provisional scale will do).
        detector: of faces.
    """
    subject, tried, reason = Subject.of_scan(scan), 0, ""
    for up in upright_candidates(subject.outline):
        cameras = cameras_around(
            subject.outline, ring(up, _COARSE_VIEWS, (0.0,)), up, size=_SIZE, fill=_FILL_COARSE
        )
        rough = triangulated(*_seen(subject, cameras, detector), _TOLERANCE_COARSE * _SIZE)
        tried += len(cameras)
        if rough is None or rough.agreeing.sum() < _FEWEST_COARSE or _axes(rough.points)[0] @ up <= 0:
            continue
        cameras = _fine_cameras(subject.outline, rough.points)
        kept, pixels = _seen(subject, cameras, detector)
        tried += len(cameras)
        result = triangulated(kept, pixels, _TOLERANCE_FINE * _SIZE)
        agree = 0 if result is None else int(result.agreeing.sum())
        if result is not None and agree >= _FEWEST_VIEWS:
            spread = spread_in_metres(kept, result)
            return FaceLandmarks(
                True,
                "views agree",
                points=result.points,
                spread_m=spread,
                views_used=agree,
                views_tried=tried,
            )
        reason = f"virtual views disagree about the face ({agree} of {len(cameras)} agree)"
    return FaceLandmarks(False, reason or f"the detector saw no face in {tried} views", views_tried=tried)


def _axes(points: Float[np.ndarray, "51 3"]) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Up and front of a face, unit vectors across each other."""
    up = points[_BROWS].mean(0) - points[_LIPS].mean(0)
    left = points[_CORNERS[0]] - points[_CORNERS[1]]
    up = up / np.linalg.norm(up)
    front = np.cross(left, up)
    return up, front / np.linalg.norm(front)


def _fine_cameras(points: Float[np.ndarray, "N 3"], rough: Float[np.ndarray, "51 3"]) -> list[Pinhole]:
    """Views that frame the face; a camera's direction is the one that it looks in."""
    up, front = _axes(rough)
    side = np.cross(up, front)
    directions = []
    for turn in np.deg2rad(_TURNS):
        for tilt in np.deg2rad(_TILTS):
            level = np.cos(turn) * front + np.sin(turn) * side
            directions.append(np.cos(tilt) * level + np.sin(tilt) * up)
    reach = _REACH * np.linalg.norm(rough - rough.mean(0), axis=1).max()
    near = points[np.linalg.norm(points - rough.mean(0), axis=1) < reach]
    framed = near if len(near) > 10 else rough
    return cameras_around(framed, -np.array(directions), up, size=_SIZE, fill=0.8)


def _seen(
    subject: Subject, cameras: list[Pinhole], detector: FaceDetector
) -> tuple[list[Pinhole], Float[np.ndarray, "C 51 2"]]:
    found = [(camera, detector.detect(subject.picture(camera))) for camera in cameras]
    kept = [(camera, pixels) for camera, pixels in found if pixels is not None]
    pixels = np.array([pixels for _, pixels in kept]).reshape(-1, len(FACE_NAMES), 2)
    return [camera for camera, _ in kept], pixels
