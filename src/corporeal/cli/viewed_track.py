"""A tracked sequence read to be looked at: rows at once, poses and scans when they are asked for."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Float32, Int
from scipy.spatial.transform import Rotation

from corporeal.cli.tracking_folder import REPORT
from corporeal.cli.tracking_outputs import frame_item
from corporeal.export.overview import LARGEST_ERROR_MM, error_colours
from corporeal.export.track_sheet import WORST_MM
from corporeal.fitting.files import (
    TEMPLATE,
    TEMPLATE_STORY,
    TrackFileError,
    frame_path,
    read_frame,
    read_story,
)
from corporeal.geometry.closest_points import SurfaceTree
from corporeal.model.files import ModelFileError, load_model
from corporeal.model.pose import FullPose
from corporeal.model.reference import reference_surface
from corporeal.model.surface_model import SurfaceModel
from corporeal.registration.session.files import read_json_file
from corporeal.registration.subjects import subject_of
from corporeal.scans.files import read_scan_points
from corporeal.scans.formats.sequence import DEFAULT_FPS
from corporeal.scans.units import UnitChoice
from corporeal.view.track import FrameRow, ShownScan, Stance, stance_of

_POINTS = 20_000
_FAR = 0.05
"""Points farther than this from the model (floor, another person) have no colour; metres."""
# Kernels with threads of their own may not run in two threads at once on every platform.
_KERNELS = threading.Lock()
_DAMAGED = "the record of this frame cannot be read: it is damaged, or being written anew"


@dataclass(frozen=True, eq=False)
class _Contents:
    """What a folder held when it was read last; replaced as a whole, so that threads see one state.

    Attributes:
        rows: of the frames that are there.
        files: of their scans, relative to the folder of the sequence.
        stamps: of their records: time and size.
        story: what ``template.json`` says.
        sequence: facts of the sequence.
    """

    rows: tuple[FrameRow, ...] = ()
    files: tuple[str, ...] = ()
    stamps: tuple[tuple[int, int], ...] = ()
    story: Mapping[str, Any] | None = None
    sequence: Mapping[str, Any] | None = None


@dataclass(frozen=True, eq=False)
class _Placed:
    """How the model lies in a frame: pose (K, 3), translation and, where there are any, offsets (V, 3)."""

    pose: Float[np.ndarray, "K 3"]
    translation: Float[np.ndarray, "3"]
    offsets: Float[np.ndarray, "V 3"] | None


class ViewedTrack:
    """The folder of a tracked sequence, finished or growing. It is a ``corporeal.view.track.Track``.

    Attributes:
        folder: of the results.
        note: what the user should know of the whole sequence, or "".
    """

    def __init__(self, folder: Path, scans: Path | None) -> None:
        """Nothing is read yet but how many frames there are.

        Args:
            folder: of the results.
            scans: where its scans lie, if not where the results say.
        """
        self.folder, self.note, self._scans = folder, "", scans
        self._now = _Contents()
        self._model: tuple[int, SurfaceModel] | None = None
        self._tree: tuple[SurfaceModel, SurfaceTree] | None = None

    @property
    def name(self) -> str:
        """Of the sequence."""
        return self.folder.name

    @property
    def fps(self) -> float:
        """Frames per second; the usual ones where nothing is known yet."""
        return float((self._now.sequence or {}).get("fps", DEFAULT_FPS))

    @property
    def rows(self) -> tuple[FrameRow, ...]:
        """The frames that are there."""
        return self._now.rows

    def faces(self) -> Int[np.ndarray, "F 3"]:
        """Of the model; ``TrackFileError`` where it cannot be read."""
        return self._subject().faces

    def refresh(self) -> bool:
        """Read what has been written since; whether frames that were there have changed.

        Raises:
            TrackFileError: ``template.json`` cannot be read.
        """
        before, story = self._now, read_story(self.folder)
        report = read_json_file(self.folder / REPORT) or {}
        self.note = _note(story, report)
        if story is None:
            self._now = _Contents()
            return bool(before.rows)
        try:
            listed = [(str(name), str(file)) for name, file in story["made_from"]["frames"]]
        except (KeyError, TypeError, ValueError) as error:
            raise TrackFileError(f"{self.folder / TEMPLATE_STORY}: does not list its frames") from error
        sequence = story.get("sequence") or report.get("sequence") or {}
        rows, files, stamps = [], [], []
        reported = self._reported(report)
        for number, (name, file) in enumerate(listed):
            stamp = _stamp(frame_path(self.folder, name))
            if stamp is None:
                break
            known = number < len(before.rows) and before.stamps[number] == stamp
            if known and before.rows[number].name == name:
                rows.append(before.rows[number])
            else:
                rows.append(self._row(name, reported, stamp))
            files.append(file)
            stamps.append(stamp)
        self._now = _Contents(tuple(rows), tuple(files), tuple(stamps), story, sequence)
        return self._now.stamps[: len(before.stamps)] != before.stamps

    def stance(self) -> Stance:
        """How the person stands in the first frame that did not fail.

        Raises:
            TrackFileError: the model cannot be read.
        """
        good = (number for number, row in enumerate(self.rows) if row.status != "failed")
        index = next(good, 0)
        axes = Rotation.from_rotvec(self._placed(index, index + 1)[0].pose[0]).as_matrix()
        return stance_of(self.vertices(index, index + 1)[0], axes[:, 1], axes[:, 2])

    def vertices(self, start: int, stop: int) -> Float32[np.ndarray, "n V 3"]:
        """The surfaces of these frames, metres: the model posed in float32, and its free vertices.

        A record that is damaged stands as the one before.
        """
        frames = self._placed(start, stop)
        poses = np.array([frame.pose for frame in frames], dtype=np.float32)
        matrices = FullPose(torch.from_numpy(poses)).matrices()
        moved = torch.from_numpy(np.array([frame.translation for frame in frames], dtype=np.float32))
        model = self._subject()
        # Plain torch: for a few frames as fast as the kernels, which would first be compiled, for a minute.
        with torch.no_grad():
            tensors, nothing = model.tensors(torch.float32), torch.zeros(len(poses), 0)
            vertices = reference_surface(tensors, nothing, matrices, moved, True).vertices.numpy()
        for number, frame in enumerate(frames):
            if frame.offsets is not None and frame.offsets.shape == vertices[number].shape:
                vertices[number] += frame.offsets
        return vertices

    def scan(self, index: int) -> ShownScan:
        """The scan of a frame, thinned, by its distance to the model; or why there is none."""
        try:
            path = self.scan_path(index)
            if path is None:
                return ShownScan.missing(
                    "the track does not say where its scans lie; name it with --scans DIR"
                )
            if not path.exists():
                return ShownScan.missing(f"no scan at {path}; if the scans have moved, say --scans DIR")
            return self._shown(index, path)
        except Exception as error:
            # One scan must not end the page; what is no fault of the file is said as well.
            return ShownScan.missing(str(error) or type(error).__name__)

    def scan_path(self, index: int) -> Path | None:
        """Where the scan of a frame should lie, or None where nothing tells."""
        now, file = self._now, Path(self._now.files[index])
        if self._scans is not None:
            places = [self._scans / self.name / file, self._scans / file, self._scans / file.name]
            return next((place for place in places if place.exists()), places[1])
        folder = (now.sequence or {}).get("folder")
        return None if folder is None else Path(folder) / file

    def release(self) -> None:
        """Let go of the model: it takes some 400 MB for a body."""
        self._model = self._tree = None

    def _shown(self, index: int, path: Path) -> ShownScan:
        model = self._subject()
        unit: UnitChoice = (self._now.story or {}).get("unit", "auto")
        points = read_scan_points(path, unit, subject_of(model).extent)
        if len(points) > _POINTS:
            points = points[np.random.default_rng(0).permutation(len(points))[:_POINTS]]
        errors = np.full(len(points), np.nan)
        if self.rows[index].status != "failed":
            vertices = self.vertices(index, index + 1)[0].astype(np.float64)
            with _KERNELS:
                metres = self._tree_at(model, vertices).closest(points).distances
            errors = np.where(metres < _FAR, 1e3 * metres, np.nan)
        colours = error_colours(errors * (LARGEST_ERROR_MM / WORST_MM))
        return ShownScan(points.astype(np.float32), (255 * colours + 0.5).astype(np.uint8))

    def _tree_at(self, model: SurfaceModel, vertices: Float[np.ndarray, "V 3"]) -> SurfaceTree:
        if self._tree is None or self._tree[0] is not model:
            self._tree = (model, SurfaceTree(vertices, model.faces))
        self._tree[1].refit(vertices)
        return self._tree[1]

    def _placed(self, start: int, stop: int) -> list[_Placed]:
        """How the model lies in these frames, from their records."""
        now = self._now
        story = now.story or {}
        last = _Placed(np.array(story["start_pose"]), np.array(story["start_translation"]), None)
        found = []
        for row in now.rows[start:stop]:
            try:
                frame = read_frame(frame_path(self.folder, row.name)).frame
                last = _Placed(frame.pose, frame.translation, frame.offsets)
            except (TrackFileError, OSError):
                pass  # its row says so
            found.append(last)
        return found

    def _subject(self) -> SurfaceModel:
        """The subject's model, read again where a restarted run has written another."""
        path = self.folder / TEMPLATE
        stamp = _stamp(path)
        if stamp is None:
            if self._model is None:
                raise TrackFileError(f"{path}: is missing; track the sequence again with --restart")
            return self._model[1]
        if self._model is None or self._model[0] != stamp[0]:
            try:
                self._model = (stamp[0], load_model(path))
            except ModelFileError as error:
                raise TrackFileError(f"{error}; track the sequence again with --restart") from error
        return self._model[1]

    def _row(self, name: str, reported: Mapping[str, Any], stamp: tuple[int, int]) -> FrameRow:
        """From the report, which is one file, or from the frame's record where that is newer."""
        item = reported.get(name)
        if item is None or stamp[0] > reported[""]:
            try:
                item = frame_item(read_frame(frame_path(self.folder, name)).frame)
            except (TrackFileError, OSError):
                return FrameRow(name, "failed", _DAMAGED, None)
        seen = tuple(
            (key.removesuffix("_seen").replace("_", " "), float(share))
            # The whole model first, then its hands.
            for key, share in sorted(
                item["signals"].items(), key=lambda signal: ("hand" in signal[0], signal)
            )
            if key.endswith(("model_seen", "hand_seen")) and share is not None
        )
        mean = (item["s2m_mm"] or {}).get("mean")
        return FrameRow(name, item["status"], item["reason"], mean, seen)

    def _reported(self, report: Mapping[str, Any]) -> dict[str, Any]:
        """The report's items by frame, and under "" when it was written."""
        stamp = _stamp(self.folder / REPORT)
        items = {item["frame"]: item for item in report.get("items", ()) if item.get("frame") is not None}
        return items | {"": 0 if stamp is None else stamp[0]}


def _note(story: Mapping[str, Any] | None, report: Mapping[str, Any]) -> str:
    lost = [item["reason"] for item in report.get("items", ()) if item.get("frame") is None]
    if lost:
        return f"tracking failed: {lost[0]}"
    return "no template yet" if story is None else ""


def _stamp(path: Path) -> tuple[int, int] | None:
    """Time of the last change in ns and size, or None where there is no file."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_mtime_ns, found.st_size
