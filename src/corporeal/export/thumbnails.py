"""A small picture of one scan of a session: the scan by its error, and the registration."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from PIL import Image
from scipy.spatial import cKDTree

from corporeal.atomic import write_bytes
from corporeal.export.overview import error_colours
from corporeal.export.shading import soft_shaded
from corporeal.geometry.cameras import Pinhole
from corporeal.geometry.normals import vertex_normals
from corporeal.geometry.rasteriser import rasterise, splat

_FIELD, _SKIN = (0.945, 0.945, 0.94), (0.93, 0.74, 0.63)
_FIELD_OF_VIEW = np.radians(20)
_SUPERSAMPLING = 2


@dataclass(frozen=True, eq=False)
class Thumbnail:
    """What is drawn, in one frame, metres.

    Attributes:
        points: of the scan.
        errors_mm: of the points; NaN is grey.
        vertices: of the registration; none where there is none.
        faces: of the registration.
        direction: in which the camera looks.
        up: what is up in the picture.
    """

    points: Float[np.ndarray, "N 3"]
    errors_mm: Float[np.ndarray, " N"]
    vertices: Float[np.ndarray, "V 3"]
    faces: Int[np.ndarray, "F 3"]
    direction: Float[np.ndarray, "3"]
    up: Float[np.ndarray, "3"]


def thumbnail_png(thumbnail: Thumbnail, size: tuple[int, int] = (150, 190)) -> bytes:
    """Draw scan and registration side by side, each of this size in pixels; what reaches beyond is cut.

    Raises:
        ValueError: neither points nor vertices, or a view direction parallel to ``up``.
    """
    framed = thumbnail.vertices if len(thumbnail.vertices) else thumbnail.points
    if not len(framed):
        raise ValueError("points: there is nothing to draw")
    large = (_SUPERSAMPLING * size[0], _SUPERSAMPLING * size[1])
    camera = Pinhole.fit_to_frame(
        framed, thumbnail.direction, thumbnail.up, fov=_FIELD_OF_VIEW, size=large, fill=0.92
    )
    page = Image.new("RGB", (2 * size[0], size[1]), tuple(int(255 * part) for part in _FIELD))
    if len(thumbnail.points):
        page.paste(_scan_picture(thumbnail, camera, size), (0, 0))
    if len(thumbnail.vertices):
        raster = rasterise(thumbnail.vertices, thumbnail.faces, camera)
        normals = vertex_normals(thumbnail.vertices, thumbnail.faces)
        picture = soft_shaded(raster, thumbnail.faces, normals, _SKIN, _FIELD)
        page.paste(_reduced(picture, size), (size[0], 0))
    buffer = io.BytesIO()
    page.save(buffer, format="PNG", compress_level=6)
    return buffer.getvalue()


def write_thumbnail(path: Path | str, thumbnail: Thumbnail) -> None:
    """Draw and write a PNG whole or not at all."""
    write_bytes(path, thumbnail_png(thumbnail))


def _scan_picture(thumbnail: Thumbnail, camera: Pinhole, size: tuple[int, int]) -> Image.Image:
    points = thumbnail.points
    sample = points[:: max(1, len(points) // 500)]
    spacing = np.median(cKDTree(points).query(sample, k=2)[0][:, 1]) if len(points) > 1 else 0.0
    raster = splat(points, None, camera, radius=max(1.5 * float(spacing), 3e-4))
    picture = soft_shaded(raster, None, None, error_colours(thumbnail.errors_mm), _FIELD)
    return _reduced(picture, size)


def _reduced(picture: Float[np.ndarray, "H W 3"], size: tuple[int, int]) -> Image.Image:
    step = _SUPERSAMPLING
    mean = picture.reshape(size[1], step, size[0], step, 3).mean(axis=(1, 3))
    return Image.fromarray((mean * 255 + 0.5).astype(np.uint8))
