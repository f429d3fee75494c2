"""Frames of a tracked sequence made ready to be drawn: scan and fit, and the hands close up."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from corporeal.cli.tracking_start import read_frame_scan
from corporeal.export.track_sheet import SheetFrame, SheetPicture
from corporeal.fitting.files import frame_path, read_frame
from corporeal.fitting.track import TrackedFrame
from corporeal.geometry.closest_points import SurfaceTree
from corporeal.model.jacobian import evaluate
from corporeal.model.statistics import PoseBlock
from corporeal.model.surface_model import SurfaceModel
from corporeal.scans.formats.sequence import ScanSequence
from corporeal.scans.scan import Scan

_SHOWN = 8
_NEVER = 0.05
"""Points farther than this from the fit (floor, another person) have no distance; metres."""


def sheet_frames(
    sequence: ScanSequence, folder: Path, model: SurfaceModel, count: int = _SHOWN
) -> Iterator[SheetFrame]:
    """At most ``count`` frames spread evenly over a sequence, seen from the front of the person.

    Args:
        sequence: whose frames all have a record.
        folder: of the records.
        model: of the subject.
        count: of frames.
    """
    chosen = np.unique(np.linspace(0, len(sequence.frames) - 1, count).round().astype(int))
    for listed in [sequence.frames[index] for index in chosen.tolist()]:
        frame = read_frame(frame_path(folder, listed.name)).frame
        scan = read_frame_scan(listed, model, sequence.unit).scan
        whole, details = _pictures(frame, scan, model)
        yield SheetFrame(whole, details, *_words(frame))


def _pictures(
    frame: TrackedFrame, scan: Scan | None, model: SurfaceModel
) -> tuple[SheetPicture, tuple[SheetPicture, ...]]:
    points = np.zeros((0, 3)) if scan is None else scan.points
    scan_faces = None if scan is None or scan.is_point_cloud else scan.faces
    R_world_root = Rotation.from_rotvec(frame.pose[0]).as_matrix()
    forward, up = R_world_root @ [0, 0, 1.0], R_world_root @ [0, 1.0, 0]
    if frame.status == "failed":
        unknown, nothing = np.full(len(points), np.nan), np.zeros((0, 3))
        return SheetPicture(points, scan_faces, unknown, nothing, model.faces, -forward, up), ()
    posed = evaluate(model, np.zeros(0), frame.pose, frame.translation)
    vertices = posed.vertices if frame.offsets is None else posed.vertices + frame.offsets
    closest = SurfaceTree(vertices, model.faces).closest(points)
    errors = np.where(closest.distances < _NEVER, 1e3 * closest.distances, np.nan)
    whole = SheetPicture(points, scan_faces, errors, vertices, model.faces, -forward, up)
    # A model of one hand is its own close-up.
    hands = [block for block in model.pose_blocks if len(block.components)] if model.side is None else []
    details = []
    for block in hands:
        wrist = int(model.parents[block.joints[0]])
        carried = model.skinning_weights[:, [wrist, *block.joints]].sum(axis=1) > 0.5
        on_hand = carried[model.faces[closest.faces]].any(axis=1) & np.isfinite(errors)
        R_world_wrist = posed.T_world_joint[wrist, :3, :3]
        details.append(_detail(whole, carried, on_hand, *_palm_view(model, block, R_world_wrist)))
    return whole, tuple(details)


def _palm_view(
    model: SurfaceModel, block: PoseBlock, R_world_wrist: Float[np.ndarray, "3 3"]
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """(view direction, up) onto the palm, fingers up: at the zero pose the palm faces down."""
    joints = np.asarray(model.joint_regressor @ model.template)
    along = joints[list(block.joints)].mean(axis=0) - joints[model.parents[block.joints[0]]]
    return R_world_wrist @ [0, 1.0, 0], R_world_wrist @ [np.sign(along[0]), 0, 0]


def _detail(
    whole: SheetPicture, carried: Bool[np.ndarray, " V"], on_hand: Bool[np.ndarray, " N"],
    direction: Float[np.ndarray, "3"], up: Float[np.ndarray, "3"],
) -> SheetPicture:  # fmt: skip
    vertices, faces = _part(whole.vertices, whole.faces, carried)
    scan_faces = whole.scan_faces
    points = whole.points[on_hand]
    if scan_faces is not None:
        points, scan_faces = _part(whole.points, scan_faces, on_hand)
    return SheetPicture(points, scan_faces, whole.errors_mm[on_hand], vertices, faces, direction, up)


def _part(
    points: Float[np.ndarray, "N 3"], faces: np.ndarray, kept: Bool[np.ndarray, " N"]
) -> tuple[np.ndarray, np.ndarray]:
    """Points that are kept, and faces that have no others."""
    renumbered = np.cumsum(kept) - 1
    return points[kept], renumbered[faces[kept[faces].all(axis=1)]]


def _words(frame: TrackedFrame) -> tuple[str, str]:
    if frame.status == "failed":
        return f"{frame.name}: failed", frame.reason
    if frame.s2m_mm is None:
        return f"{frame.name}: {frame.status}", frame.reason
    return f"{frame.name}: {frame.status}, s2m {frame.s2m_mm['mean']:.2f} mm", frame.reason
