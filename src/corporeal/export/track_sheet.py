"""A contact sheet of a tracked sequence: scan and fit side by side in frames spread over it."""

from __future__ import annotations

import io
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from PIL import Image, ImageDraw, ImageFont
from scipy.spatial import cKDTree

from corporeal.atomic import write_bytes
from corporeal.export.overview import LARGEST_ERROR_MM, error_colours
from corporeal.export.shading import soft_shaded
from corporeal.geometry.cameras import Pinhole
from corporeal.geometry.normals import vertex_normals
from corporeal.geometry.rasteriser import rasterise, splat

_COLUMNS = 4
_TILE, _SMALL = (220, 320), (110, 130)
_MARGIN, _HEADING, _LEGEND_LINE, _CAPTION = 12, 34, 24, 40
_SUPERSAMPLING = 2
_FIELD_OF_VIEW = np.radians(20)
_PAPER, _INK, _FAINT, _BAD = (250, 250, 249), (38, 40, 44), (110, 112, 116), (176, 58, 40)
_FIELD, _SKIN = (0.945, 0.945, 0.94), (0.93, 0.74, 0.63)
# Scanners of bodies have a millimetre of noise: the scale of hands' registrations would show nothing else.
WORST_MM = 10.0
_LEGEND = (
    f"left: scan by its distance to the fit (blue 0, yellow {0.6 * WORST_MM:.0f}, red {WORST_MM:.0f} mm "
    "and more, grey far); right: fit; beneath, of a body: its palms"
)


@dataclass(frozen=True, eq=False)
class SheetPicture:
    """A scan and what was fitted to it under one camera; all in one frame, metres.

    Attributes:
        points: of the scan; none where it could not be read.
        scan_faces: its faces, or None for a point cloud.
        errors_mm: of the points; NaN is grey.
        vertices: of the fit; none where there is none.
        faces: of the fit.
        direction: in which the camera looks.
        up: what is up in the picture.
    """

    points: Float[np.ndarray, "N 3"]
    scan_faces: Int[np.ndarray, "f 3"] | None
    errors_mm: Float[np.ndarray, " N"]
    vertices: Float[np.ndarray, "V 3"]
    faces: Int[np.ndarray, "F 3"]
    direction: Float[np.ndarray, "3"]
    up: Float[np.ndarray, "3"]


@dataclass(frozen=True, eq=False)
class SheetFrame:
    """One frame of the sheet.

    Attributes:
        whole: the scan and the fit.
        details: parts of them, at most two, drawn small beneath.
        below: words under it.
        reason: a second line, red: what is wrong with the frame.
    """

    whole: SheetPicture
    details: tuple[SheetPicture, ...]
    below: str
    reason: str = ""


def write_track_sheet(path: Path | str, title: str, frames: Iterable[SheetFrame]) -> None:
    """Draw and write a PNG, four frames in a row; a frame is let go before the next is asked for.

    Raises:
        ValueError: there is no frame, or a view direction is parallel to ``up``.
        OSError: the file cannot be written.
    """
    cells = [_cell(frame) for frame in frames]
    if not cells:
        raise ValueError("frames: there is nothing to draw")
    columns = min(_COLUMNS, len(cells))
    width, height = cells[0].width, max(cell.height for cell in cells)
    rows, top = -(-len(cells) // columns), _HEADING + _LEGEND_LINE
    size = max(columns * (width + _MARGIN) + _MARGIN, 720), top + rows * (height + _MARGIN)
    page = Image.new("RGB", size, _PAPER)
    draw = ImageDraw.Draw(page)
    draw.text((_MARGIN, 9), title, _INK, _font(18))
    draw.text((_MARGIN, _HEADING), _LEGEND, _FAINT, _font(13))
    for number, cell in enumerate(cells):
        row, column = divmod(number, columns)
        page.paste(cell, (_MARGIN + column * (width + _MARGIN), top + row * (height + _MARGIN)))
    buffer = io.BytesIO()
    page.save(buffer, format="PNG", compress_level=6)
    write_bytes(path, buffer.getvalue())


def _cell(frame: SheetFrame) -> Image.Image:
    """Scan and fit, details, words."""
    width, below = 2 * _TILE[0], _TILE[1] + (_SMALL[1] if frame.details else 0)
    cell = Image.new("RGB", (width, below + _CAPTION), _PAPER)
    cell.paste(_pair(frame.whole, _TILE), (0, 0))
    for number, detail in enumerate(frame.details[:2]):
        cell.paste(_pair(detail, _SMALL), (number * 2 * _SMALL[0], _TILE[1]))
    draw = ImageDraw.Draw(cell)
    draw.text((4, below + 2), frame.below, _INK, _font(14))
    draw.text((4, below + 20), _fitting(frame.reason, width - 8), _BAD, _font(12))
    return cell


def _pair(picture: SheetPicture, size: tuple[int, int]) -> Image.Image:
    """Scan and fit under the same camera; what reaches beyond the fit's frame is cut."""
    page = Image.new("RGB", (2 * size[0], size[1]), tuple(int(255 * part) for part in _FIELD))
    framed = picture.vertices if len(picture.vertices) else picture.points
    if len(framed):
        large = (_SUPERSAMPLING * size[0], _SUPERSAMPLING * size[1])
        camera = Pinhole.fit_to_frame(
            framed, picture.direction, picture.up, fov=_FIELD_OF_VIEW, size=large, fill=0.92
        )
        if len(picture.points):
            page.paste(_scan(picture, camera), (0, 0))
        if len(picture.vertices):
            fit = _surface(picture.vertices, picture.faces, _SKIN, camera)
            page.paste(fit, (size[0], 0))
    if not len(picture.points):
        ImageDraw.Draw(page).text((size[0] / 2, size[1] / 2), "no scan", _FAINT, _font(13), anchor="mm")
    return page


def _scan(picture: SheetPicture, camera: Pinhole) -> Image.Image:
    colours = error_colours(picture.errors_mm * (LARGEST_ERROR_MM / WORST_MM))
    points = picture.points
    if picture.scan_faces is not None and len(picture.scan_faces):
        return _surface(points, picture.scan_faces, colours, camera)
    sample = points[:: max(1, len(points) // 500)]
    spacing = np.median(cKDTree(points).query(sample, k=2)[0][:, 1]) if len(points) > 1 else 0.0
    raster = splat(points, None, camera, radius=max(1.5 * float(spacing), 3e-4))
    return _reduced(soft_shaded(raster, None, None, colours, _FIELD))


def _surface(
    vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"],
    colours: Float[np.ndarray, "V 3"] | tuple[float, float, float], camera: Pinhole,
) -> Image.Image:  # fmt: skip
    normals = vertex_normals(vertices, faces)
    return _reduced(soft_shaded(rasterise(vertices, faces, camera), faces, normals, colours, _FIELD))


def _reduced(picture: Float[np.ndarray, "H W 3"]) -> Image.Image:
    step = _SUPERSAMPLING
    height, width = picture.shape[0] // step, picture.shape[1] // step
    mean = picture.reshape(height, step, width, step, 3).mean(axis=(1, 3))
    return Image.fromarray((mean * 255 + 0.5).astype(np.uint8))


def _fitting(words: str, width: int) -> str:
    """As much of a sentence as has room."""
    font, shown = _font(12), " ".join(words.split())
    while shown and font.getlength(shown) > width:
        shown = f"{shown[:-4].rstrip()}..." if len(shown) > 4 else ""
    return shown


def _font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(size=size)
