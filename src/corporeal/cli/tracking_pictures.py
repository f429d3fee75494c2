"""Frames of a tracked sequence made ready to be drawn: the scan by its distance, and the fit."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from corporeal.cli.tracking_start import read_frame_scan
from corporeal.export.thumbnails import Thumbnail
from corporeal.export.track_sheet import SheetFrame
from corporeal.fitting.track import TrackedFrame
from corporeal.geometry.closest_points import SurfaceTree
from corporeal.model.jacobian import evaluate
from corporeal.model.surface_model import SurfaceModel
from corporeal.scans.formats.sequence import ScanSequence

_SHOWN = 8
_POINTS = 20_000
_NEVER = 0.05
"""Points farther than this from the fit (floor, another person) have no distance; metres."""


def sheet_frames(
    sequence: ScanSequence, frames: list[TrackedFrame], model: SurfaceModel, count: int = _SHOWN
) -> Iterator[SheetFrame]:
    """At most ``count`` frames spread evenly over a sequence, seen from the front of the person."""
    chosen = np.unique(np.linspace(0, len(frames) - 1, count).round().astype(int))
    for index in chosen.tolist():
        frame = frames[index]
        scan = read_frame_scan(sequence.frames[index], model, sequence.unit).scan
        points = np.zeros((0, 3)) if scan is None else scan.points
        points = points[:: max(1, -(-len(points) // _POINTS))]
        yield SheetFrame(_thumbnail(frame, points, model), *_words(frame))


def _thumbnail(frame: TrackedFrame, points: Float[np.ndarray, "N 3"], model: SurfaceModel) -> Thumbnail:
    vertices, errors = np.zeros((0, 3)), np.full(len(points), np.nan)
    if frame.status != "failed":
        vertices = evaluate(model, np.zeros(0), frame.pose, frame.translation).vertices
        if len(points):
            metres = SurfaceTree(vertices, model.faces).closest(points).distances
            errors = np.where(metres < _NEVER, 1e3 * metres, np.nan)
    R_world_root = Rotation.from_rotvec(frame.pose[0]).as_matrix()
    forward, up = R_world_root @ [0, 0, 1.0], R_world_root @ [0, 1.0, 0]
    return Thumbnail(points, errors, vertices, model.faces, -forward, up)


def _words(frame: TrackedFrame) -> tuple[str, str]:
    if frame.status == "failed":
        return f"{frame.name}: failed", frame.reason
    if frame.s2m_mm is None:
        return f"{frame.name}: {frame.status}", frame.reason
    return f"{frame.name}: {frame.status}, s2m {frame.s2m_mm['mean']:.2f} mm", frame.reason
