"""A contact sheet of a tracked sequence: scan and fit side by side in frames spread over it."""

from __future__ import annotations

import io
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from PIL import Image, ImageDraw, ImageFont

from corporeal.atomic import write_bytes
from corporeal.export.thumbnails import Thumbnail, thumbnail_png

_COLUMNS = 4
_TILE = (230, 330)
_MARGIN, _HEADING, _CAPTION = 12, 34, 40
_PAPER, _INK, _FAINT, _BAD = (250, 250, 249), (38, 40, 44), (110, 112, 116), (176, 58, 40)
_LEGEND = "left: scan by its distance to the fit (blue 0, yellow 2, red 3 mm and more, grey far); right: fit"


@dataclass(frozen=True, eq=False)
class SheetFrame:
    """One frame of the sheet.

    Attributes:
        picture: scan and fit; both may be empty, of a frame that could not be read.
        below: words under it.
        reason: a second line, red: what is wrong with the frame.
    """

    picture: Thumbnail
    below: str
    reason: str = ""


def write_track_sheet(path: Path | str, title: str, frames: Iterable[SheetFrame]) -> None:
    """Draw and write a PNG, four frames in a row; a frame is let go before the next is asked for.

    Raises:
        ValueError: there is no frame.
        OSError: the file cannot be written.
    """
    cells = [_cell(frame) for frame in frames]
    if not cells:
        raise ValueError("frames: there is nothing to draw")
    columns = min(_COLUMNS, len(cells))
    width, height = cells[0].size
    rows = -(-len(cells) // columns)
    page = Image.new(
        "RGB",
        (max(columns * (width + _MARGIN) + _MARGIN, 760), _HEADING + 24 + rows * (height + _MARGIN)),
        _PAPER,
    )
    draw = ImageDraw.Draw(page)
    draw.text((_MARGIN, 9), title, _INK, _font(18))
    draw.text((_MARGIN, _HEADING), _LEGEND, _FAINT, _font(13))
    for number, cell in enumerate(cells):
        row, column = divmod(number, columns)
        page.paste(cell, (_MARGIN + column * (width + _MARGIN), _HEADING + 24 + row * (height + _MARGIN)))
    buffer = io.BytesIO()
    page.save(buffer, format="PNG", compress_level=6)
    write_bytes(path, buffer.getvalue())


def _cell(frame: SheetFrame) -> Image.Image:
    """Scan and fit with words below."""
    width = 2 * _TILE[0]
    cell = Image.new("RGB", (width, _TILE[1] + _CAPTION), _PAPER)
    picture = frame.picture
    draw = ImageDraw.Draw(cell)
    if len(picture.points) or len(picture.vertices):
        cell.paste(Image.open(io.BytesIO(thumbnail_png(picture, _TILE))), (0, 0))
    else:
        draw.rectangle((0, 0, width - 1, _TILE[1] - 1), outline=_FAINT)
        draw.text((width / 2, _TILE[1] / 2), "no scan", _FAINT, _font(15), anchor="mm")
    draw.text((4, _TILE[1] + 2), frame.below, _INK, _font(14))
    draw.text((4, _TILE[1] + 20), _fitting(frame.reason, width - 8), _BAD, _font(12))
    return cell


def _fitting(words: str, width: int) -> str:
    """As much of a sentence as has room."""
    font, shown = _font(12), " ".join(words.split())
    while shown and font.getlength(shown) > width:
        shown = f"{shown[:-4].rstrip()}..." if len(shown) > 4 else ""
    return shown


def _font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(size=size)
