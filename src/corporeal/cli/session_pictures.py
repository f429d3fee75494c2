"""What the pages and reports on a session draw of one of its scans."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from corporeal.cli.errors import CommandError
from corporeal.export.overview import error_colours
from corporeal.export.thumbnails import Thumbnail, write_thumbnail
from corporeal.geometry.closest_points import SurfaceTree
from corporeal.model.files import ModelFileError, load_model, open_model
from corporeal.model.surface_model import SurfaceModel
from corporeal.registration.session.files import MANIFEST, MODEL, read_json_file, read_record, record_path
from corporeal.registration.session.records import SessionRecord
from corporeal.scans.files import read_scan
from corporeal.scans.scan import Scan
from corporeal.scans.units import ANY_EXTENT, HAND_EXTENT, UnitChoice
from corporeal.view.curation import ScanDisplay

_DISPLAYED_POINTS, _THUMBNAIL_POINTS = 30_000, 8_000
_NEVER = 0.05
"""Points farther than this from the registration (arm, stand) have no error; metres."""


def model_of(folder: Path) -> SurfaceModel:
    """The model that a session was registered with: its copy in the folder, else what the manifest names.

    Raises:
        CommandError: the model cannot be read.
    """
    kept = folder / MODEL
    if kept.is_file():
        try:
            return load_model(kept)
        except (ModelFileError, OSError) as error:
            raise CommandError(f"{kept}: {error}", 2) from error
    manifest = read_json_file(folder / MANIFEST) or {}
    named = manifest.get("model", "hand")
    name = str(named.get("name", "hand") if isinstance(named, dict) else named)
    try:
        return load_model(Path(name)) if Path(name).suffix else open_model(name)
    except (ModelFileError, OSError) as error:
        raise CommandError(f"the model {name!r}, which {folder / MANIFEST} names: {error}", 2) from error


def scan_of(record: SessionRecord, session: Path | None) -> Scan:
    """The scan of a record in metres, from the session's folder, or from where the record says that it lies.

    Raises:
        ScanFileError: it cannot be read.
    """
    row = record.row
    path = Path(row["scan"])
    if session is not None:
        candidates = (session / path.name, session / "scans" / path.name)
        path = next((candidate for candidate in candidates if candidate.exists()), path)
    unit: UnitChoice = row.get("unit") or "auto"
    scan = read_scan(path, unit, HAND_EXTENT if unit == "auto" else ANY_EXTENT)
    if unit == "free" and row.get("metres_per_unit"):
        scan = scan.with_scale(row["metres_per_unit"])
    return scan


@dataclass(frozen=True, eq=False)
class SessionPictures:
    """Reads scans and records of a registered session to draw them.

    Attributes:
        folder: of the results.
        session: folder of the scans, or None for where the records say that they lie.
        model: that was registered, of either side.
    """

    folder: Path
    session: Path | None
    model: SurfaceModel

    def display(self, name: str) -> ScanDisplay:
        """What is drawn on the page: palm to the viewer, fingers up; it says if a scan cannot be read."""
        record = read_record(record_path(self.folder, name))
        picture, note = self._picture(record, _DISPLAYED_POINTS)
        R_display_scan = np.stack([np.cross(picture.up, -picture.direction), picture.up, -picture.direction])
        framed = picture.vertices if len(picture.vertices) else picture.points
        centre = framed.mean(axis=0) if len(framed) else np.zeros(3)
        return ScanDisplay(
            points=(picture.points - centre) @ R_display_scan.T,
            colours=(255 * error_colours(picture.errors_mm) + 0.5).astype(np.uint8),
            vertices=(picture.vertices - centre) @ R_display_scan.T,
            faces=picture.faces,
            note=note,
        )

    def thumbnail(self, name: str) -> Path:
        """Where the scan's thumbnail lies; it is drawn unless it is newer than the record."""
        path, source = self.folder / "thumbnails" / f"{name}.png", record_path(self.folder, name)
        if not path.exists() or path.stat().st_mtime < source.stat().st_mtime:
            write_thumbnail(path, self.picture(read_record(source)))
        return path

    def picture(self, record: SessionRecord) -> Thumbnail:
        """What a thumbnail shows.

        Raises:
            ValueError: there is neither a scan nor a registration to draw.
        """
        return self._picture(record, _THUMBNAIL_POINTS)[0]

    def _picture(self, record: SessionRecord, most: int) -> tuple[Thumbnail, str]:
        note, points = "", np.zeros((0, 3))
        try:
            points = scan_of(record, self.session).points
        except (ValueError, OSError) as error:
            note = f"the scan is not shown: {error}"
        points = points[:: max(1, -(-len(points) // most))]
        vertices = np.zeros((0, 3)) if record.vertices is None else record.vertices
        faces = self.model.faces if record.side == self.model.side else self.model.faces[:, ::-1]
        errors = np.full(len(points), np.nan)
        if len(vertices) and len(points):
            metres = SurfaceTree(vertices, faces).closest(points).distances
            errors = np.where(metres < _NEVER, 1e3 * metres, np.nan)
        direction, up = self._view(record, points)
        return Thumbnail(points, errors, vertices, np.ascontiguousarray(faces), direction, up), note

    def _view(
        self, record: SessionRecord, points: np.ndarray
    ) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
        """(view direction, up) in the scan's frame: onto the palm; without one onto the flat side."""
        if record.pose is None:
            if len(points) < 3:
                return np.array([0.0, 0.0, -1.0]), np.array([0.0, 1.0, 0.0])
            axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2]
            return axes[2], axes[0]
        R_world_root = Rotation.from_rotvec(record.pose[0]).as_matrix()
        template = self.model.template
        along = template.mean(axis=0) - np.asarray(self.model.joint_regressor @ template)[0]
        if record.side != self.model.side:
            along = along * np.array([-1.0, 1.0, 1.0])
        up = R_world_root @ (along / np.linalg.norm(along))
        direction = R_world_root @ np.array([0.0, 1.0, 0.0])
        direction = direction - (direction @ up) * up
        return direction / np.linalg.norm(direction), up
