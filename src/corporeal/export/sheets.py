"""Sheets of rendered surfaces: tiles in rows and columns under one camera, with headings."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int, UInt8
from PIL import Image, ImageDraw, ImageFont

from corporeal.atomic import write_bytes
from corporeal.export.shading import soft_shaded
from corporeal.geometry.cameras import Pinhole
from corporeal.geometry.normals import vertex_normals
from corporeal.geometry.rasteriser import rasterise
from corporeal.model.surface_model import SurfaceModel

Colour = tuple[float, float, float]

SKIN: Colour = (0.93, 0.76, 0.66)
_SUPERSAMPLING = 2
_FIELD_OF_VIEW = np.radians(14)
_PAPER, _INK, _FAINT = (250, 250, 249), (38, 40, 44), (110, 112, 116)
_FIELD = (250 / 255, 250 / 255, 249 / 255)
_MARGIN, _HEADING, _SIDE, _GAP = 12, 34, 62, 4


@dataclass(frozen=True, eq=False)
class View:
    """From where a surface is seen.

    Attributes:
        name: for instance "back".
        direction: in which the camera looks.
        up: what is up in the picture; not parallel to the direction.
    """

    name: str
    direction: Float[np.ndarray, "3"]
    up: Float[np.ndarray, "3"]


@dataclass(frozen=True, eq=False)
class Tile:
    """One surface of a sheet.

    Attributes:
        vertices: metres.
        faces: corner indices.
        colours: 0..1, per vertex or one for all.
        below: words under it.
    """

    vertices: Float[np.ndarray, "V 3"]
    faces: Int[np.ndarray, "F 3"]
    colours: Float[np.ndarray, "V 3"] | Colour = SKIN
    below: str = ""


@dataclass(frozen=True, eq=False)
class Layout:
    """What stands around the tiles.

    Attributes:
        tile: width and height of a tile, pixels.
        columns: heading of every column.
        rows: words at the left of every row; empty texts leave no room.
        title: line above all; empty leaves no room.
    """

    tile: tuple[int, int]
    columns: Sequence[str]
    rows: Sequence[str]
    title: str = ""

    @property
    def origin(self) -> tuple[int, int]:
        """Left and top of the first tile."""
        side = _SIDE if any(self.rows) else 0
        return _MARGIN + side, _MARGIN + (_HEADING if self.title else 0) + (
            _HEADING if any(self.columns) else 0
        )

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the sheet."""
        left, top = self.origin
        return (
            left + len(self.columns) * (self.tile[0] + _GAP) - _GAP + _MARGIN,
            top + len(self.rows) * (self.tile[1] + _GAP) - _GAP + _MARGIN,
        )

    def place(self, row: float | int, column: int) -> tuple[int, int]:
        """Left and top of a tile; between two rows where the row is a fraction."""
        left, top = self.origin
        return left + round(column * (self.tile[0] + _GAP)), top + round(row * (self.tile[1] + _GAP))


def blank_sheet(layout: Layout) -> Image.Image:
    """Paper with title, headings and row names."""
    page = Image.new("RGB", layout.size, _PAPER)
    draw = ImageDraw.Draw(page)
    if layout.title:
        draw.text((_MARGIN, _MARGIN), layout.title, _INK, _font(17))
    for column, words in enumerate(layout.columns):
        left, top = layout.place(0, column)
        draw.text((left + layout.tile[0] / 2, top - 10), words, _INK, _font(15), anchor="ms")
    for row, words in enumerate(layout.rows):
        left, top = layout.place(row, 0)
        draw.text((_MARGIN, top + layout.tile[1] / 2), words, _FAINT, _font(15), anchor="lm")
    return page


def put_tile(
    page: Image.Image, layout: Layout, tile: Tile, camera: Pinhole, row: float | int, column: int
) -> None:
    """Draw a tile into the sheet; the camera is one of ``sheet_camera``."""
    left, top = layout.place(row, column)
    page.paste(_rendered(tile, camera), (left, top))
    if tile.below:
        at = (left + layout.tile[0] / 2, top + layout.tile[1] - 4)
        ImageDraw.Draw(page).text(at, tile.below, _FAINT, _font(13), anchor="ms")


def put_words(page: Image.Image, layout: Layout, row: int, words: str) -> None:
    """Words in the upper left corner of a row's first tile: room for more than stands at its left."""
    left, top = layout.place(row, 0)
    ImageDraw.Draw(page).text((left + 4, top + 2), words, _FAINT, _font(15))


def sheet_camera(
    layout: Layout, view: View, surfaces: Sequence[Float[np.ndarray, "V 3"]], fill: float = 0.92
) -> Pinhole:
    """The camera that sees every one of the surfaces whole, so that their sizes can be compared."""
    size = (_SUPERSAMPLING * layout.tile[0], _SUPERSAMPLING * layout.tile[1])
    points = np.concatenate(list(surfaces))
    return Pinhole.fit_to_frame(points, view.direction, view.up, fov=_FIELD_OF_VIEW, size=size, fill=fill)


def overlaid(first: Tile, second: Tile) -> Tile:
    """Both surfaces in one tile: at every pixel the nearer one is seen."""
    return Tile(
        np.concatenate([first.vertices, second.vertices]),
        np.concatenate([first.faces, len(first.vertices) + second.faces]),
        np.concatenate([_per_vertex(first), _per_vertex(second)]),
    )


def sheet_pixels(page: Image.Image) -> UInt8[np.ndarray, "H W 3"]:
    """The sheet as numbers."""
    return np.asarray(page, dtype=np.uint8).copy()


def write_sheet(path: Path | str, picture: UInt8[np.ndarray, "H W 3"]) -> None:
    """Write a picture as PNG, whole or not at all.

    Raises:
        OSError: it cannot be written.
    """
    buffer = io.BytesIO()
    Image.fromarray(picture).save(buffer, format="PNG", compress_level=6)
    write_bytes(path, buffer.getvalue())


def model_views(model: SurfaceModel) -> tuple[View, View, View]:
    """Three views of a surface whose root is not turned.

    Of a single hand, fingers up: its back, its palm, and the palm from the thumb's side and a little from the
    wrist, where flexed fingers stand apart (of ten views of the first pose components the one in which the
    most fingers were seen). Of anything else: front, side and between the two.
    """
    if model.side is None:
        up = np.array([0.0, 1, 0])
        return (
            View("front", np.array([0.0, 0, -1]), up),
            View("side", np.array([-1.0, 0, 0]), up),
            View("between", np.array([-0.7, -0.3, -0.7]), up),
        )
    along = model.template.mean(axis=0) - np.asarray(model.joint_regressor @ model.template)[0]
    fingers = np.array([np.sign(along[0]), 0.0, 0.0])
    return (
        View("back", -0.35 * fingers + [0.0, -1.0, -0.15], fingers),
        View("palm", -0.15 * fingers + [0.0, 1.0, -0.1], fingers),
        View("thumb side", 0.2 * fingers + [0.0, 0.8, -0.5], fingers),
    )


def _rendered(tile: Tile, camera: Pinhole) -> Image.Image:
    raster = rasterise(tile.vertices, tile.faces, camera)
    picture = soft_shaded(raster, tile.faces, vertex_normals(tile.vertices, tile.faces), tile.colours, _FIELD)
    step = _SUPERSAMPLING
    height, width = camera.height // step, camera.width // step
    mean = picture.reshape(height, step, width, step, 3).mean(axis=(1, 3))
    return Image.fromarray((mean * 255 + 0.5).astype(np.uint8))


def _per_vertex(tile: Tile) -> Float[np.ndarray, "V 3"]:
    colours = np.empty((len(tile.vertices), 3))
    colours[:] = tile.colours
    return colours


def _font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(size=size)
