"""One picture of one registration: scan, model, registration and error, from both sides of the hand."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from PIL import Image, ImageDraw, ImageFont
from scipy.spatial import cKDTree

from corporeal.atomic import write_bytes
from corporeal.export.shading import soft_shaded
from corporeal.geometry.cameras import Pinhole
from corporeal.geometry.normals import vertex_normals
from corporeal.geometry.rasteriser import Raster, rasterise, splat

_PANEL = (340, 420)
_SUPERSAMPLING = 2
_FIELD_OF_VIEW = np.radians(20)
_MARGIN, _HEADER, _BAR = 14, 84, 92
_PAPER, _FIELD, _INK, _FAINT = (250, 250, 249), (0.945, 0.945, 0.94), (38, 40, 44), (120, 122, 126)
_SCAN, _MODEL, _REGISTRATION = (0.86, 0.82, 0.77), (0.62, 0.73, 0.86), (0.93, 0.74, 0.63)
LARGEST_ERROR_MM = 3.0
_UNSCORED = (0.74, 0.74, 0.74)
# From no error to the largest, evenly spaced: dark blue, blue, pale green, yellow, orange, dark red.
_SCALE = np.array(
    [
        [0.15, 0.25, 0.52], [0.20, 0.52, 0.72], [0.60, 0.82, 0.68], [0.98, 0.90, 0.55], [0.94, 0.52, 0.25],
        [0.65, 0.05, 0.12],
    ]
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Overview:
    """What the picture shows; all points in one frame, metres.

    Attributes:
        scan_points: N points of the scan.
        scan_faces: its faces, or None for a point cloud.
        scan_normals: per point, or None where they are unknown.
        model_vertices: the posed model alone.
        registration_vertices: the registration.
        faces: faces of model and registration.
        point_errors_mm: distance of every scan point to the registration; NaN where it is not scored (grey).
        views: (direction in which the camera looks, direction that is up in the picture), one per row.
        view_names: one per row.
        title: lines at the top; the first one is set larger.
    """

    scan_points: Float[np.ndarray, "N 3"]
    scan_faces: Int[np.ndarray, "f 3"] | None
    scan_normals: Float[np.ndarray, "N 3"] | None
    model_vertices: Float[np.ndarray, "V 3"]
    registration_vertices: Float[np.ndarray, "V 3"]
    faces: Int[np.ndarray, "F 3"]
    point_errors_mm: Float[np.ndarray, " N"]
    views: tuple[tuple[Float[np.ndarray, 3], Float[np.ndarray, 3]], ...]
    view_names: tuple[str, ...] = ("palm", "back")
    title: tuple[str, ...] = ()


def write_overview(path: Path | str, overview: Overview) -> None:
    """Draw and write a PNG: a row per view; columns scan, model, registration, error in mm on the scan.

    The frame is set by the registration and the scored scan points; what reaches beyond it (an arm) is cut.

    Raises:
        ValueError: a view whose two directions are parallel, or not as many names as views.
    """
    if len(overview.view_names) != len(overview.views):
        raise ValueError(f"view_names: {len(overview.view_names)} names for {len(overview.views)} views")
    columns = 4
    width = _MARGIN + columns * (_PANEL[0] + _MARGIN) + _BAR
    height = _HEADER + len(overview.views) * (_PANEL[1] + _MARGIN)
    page = Image.new("RGB", (width, height), _PAPER)
    draw = ImageDraw.Draw(page)
    for row in range(len(overview.views)):
        top = _HEADER + row * (_PANEL[1] + _MARGIN)
        for column, panel in enumerate(_panels(overview, row)):
            page.paste(panel, (_MARGIN + column * (_PANEL[0] + _MARGIN), top))
        draw.text((_MARGIN + 8, top + 6), overview.view_names[row], _FAINT, _font(14))
    _draw_words(draw, overview)
    _draw_scale(page, width - _BAR + 6, _HEADER, height - _HEADER - _MARGIN)
    buffer = io.BytesIO()
    page.save(buffer, format="PNG", compress_level=4)
    write_bytes(path, buffer.getvalue())


def error_colours(errors_mm: Float[np.ndarray, " N"]) -> Float[np.ndarray, "N 3"]:
    """Colours 0..1 of errors: dark blue at 0, yellow near 2, dark red at 3 mm and beyond, grey for NaN."""
    places = np.clip(errors_mm / LARGEST_ERROR_MM, 0, 1) * (len(_SCALE) - 1)
    known = np.isfinite(places)
    colours = np.empty((len(errors_mm), 3))
    colours[:] = _UNSCORED
    for channel in range(3):
        colours[known, channel] = np.interp(places[known], np.arange(len(_SCALE)), _SCALE[:, channel])
    return colours


def _panels(overview: Overview, row: int) -> list[Image.Image]:
    """The four pictures of one view."""
    direction, up = overview.views[row]
    scored = overview.scan_points[np.isfinite(overview.point_errors_mm)]
    size = (_SUPERSAMPLING * _PANEL[0], _SUPERSAMPLING * _PANEL[1])
    camera = Pinhole.fit_to_frame(
        np.concatenate([overview.registration_vertices, scored]),
        direction, up, fov=_FIELD_OF_VIEW, size=size, fill=0.90,
    )  # fmt: skip
    scan = _scan_raster(overview, camera)
    normals = _scan_normals(overview)
    pictures = [soft_shaded(scan, overview.scan_faces, normals, _SCAN, _FIELD)]
    for vertices, colour in (
        (overview.model_vertices, _MODEL),
        (overview.registration_vertices, _REGISTRATION),
    ):
        raster = rasterise(vertices, overview.faces, camera)
        pictures.append(
            soft_shaded(raster, overview.faces, vertex_normals(vertices, overview.faces), colour, _FIELD)
        )
    errors = error_colours(overview.point_errors_mm)
    pictures.append(soft_shaded(scan, overview.scan_faces, normals, errors, _FIELD))
    return [_reduced(picture) for picture in pictures]


def _scan_raster(overview: Overview, camera: Pinhole) -> Raster:
    points = overview.scan_points
    if overview.scan_faces is not None:
        return rasterise(points, overview.scan_faces, camera)
    # Discs that just overlap: the spacing is measured on a sample, since it may be uneven and points many.
    sample = points[:: max(1, len(points) // 2000)]
    spacing = np.median(cKDTree(points).query(sample, k=2)[0][:, 1])
    return splat(points, overview.scan_normals, camera, radius=max(1.2 * float(spacing), 1e-5))


def _scan_normals(overview: Overview) -> np.ndarray | None:
    if overview.scan_normals is None and overview.scan_faces is not None:
        return vertex_normals(overview.scan_points, overview.scan_faces)
    return overview.scan_normals


def _reduced(picture: Float[np.ndarray, "H W 3"]) -> Image.Image:
    """Antialiasing: the mean over the samples of every pixel."""
    step = _SUPERSAMPLING
    mean = picture.reshape(_PANEL[1], step, _PANEL[0], step, 3).mean(axis=(1, 3))
    return Image.fromarray((mean * 255 + 0.5).astype(np.uint8))


def _font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(size=size)


def _draw_words(draw: ImageDraw.ImageDraw, overview: Overview) -> None:
    for number, line in enumerate(overview.title[:2]):
        ink, size = (_INK, 18) if number == 0 else (_FAINT, 14)
        draw.text((_MARGIN, 10 + 25 * number), line, ink, _font(size))
    for column, name in enumerate(("scan", "model", "registration", "error on the scan")):
        draw.text((_MARGIN + column * (_PANEL[0] + _MARGIN), _HEADER - 23), name, _INK, _font(15))


def _draw_scale(page: Image.Image, left: int, top: int, height: int) -> None:
    """The bar of error colours, 0 at the bottom."""
    draw = ImageDraw.Draw(page)
    first, tall, wide = top + 30, min(height - 90, 360), 18
    errors = np.linspace(LARGEST_ERROR_MM, 0, tall)
    strip = (error_colours(errors) * 255 + 0.5).astype(np.uint8)
    page.paste(Image.fromarray(np.repeat(strip[:, None], wide, axis=1)), (left, first))
    draw.text((left, top + 4), "mm", _INK, _font(14))
    for error in range(int(LARGEST_ERROR_MM) + 1):
        at = first + (tall - 1) * (1 - error / LARGEST_ERROR_MM)
        beyond = "+" if error == int(LARGEST_ERROR_MM) else ""
        draw.line((left + wide, at, left + wide + 5, at), _FAINT)
        draw.text((left + wide + 9, at), f"{error}{beyond}", _INK, _font(14), anchor="lm")
    grey = tuple(int(255 * part) for part in _UNSCORED)
    draw.rectangle((left, first + tall + 16, left + wide, first + tall + 30), grey)
    draw.text((left, first + tall + 36), "not\nscored", _FAINT, _font(13))
