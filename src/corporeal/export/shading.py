"""Soft shading of rasters for pictures that people judge registrations by."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from corporeal.geometry.rasteriser import Raster

# Directions towards the lights in the camera's frame (x right, y down, z forward), and their strengths.
_LIGHTS = (((-0.45, -0.65, -0.61), 0.56), ((0.75, -0.10, -0.65), 0.22), ((0.0, 0.0, -1.0), 0.18))
_AMBIENT = 0.26
# Pixels behind a nearer neighbour are darkened over this depth (metres): fingers stand out from the palm.
_EDGE_DEPTH = 0.004
_EDGE_STRENGTH = 0.55


def soft_shaded(
    raster: Raster, faces: Int[np.ndarray, "F 3"] | None, normals: Float[np.ndarray, "N 3"] | None,
    colours: Float[np.ndarray, "N 3"] | tuple[float, float, float], background: tuple[float, float, float],
) -> Float[np.ndarray, "H W 3"]:  # fmt: skip
    """Three lights fixed to the camera, interpolated normals, and dark rims where the depth jumps.

    Args:
        raster: what the camera sees.
        faces: the faces that were drawn; None for a raster of points.
        normals: per vertex, either sign; None lights everything from the front.
        colours: per vertex or one for all, 0..1.
        background: colour of pixels that see nothing, 0..1.

    Returns:
        A picture with values 0..1.
    """
    seen = raster.covered
    index, weights = raster.face[seen], raster.barycentric[seen]
    corners = np.repeat(index[:, None], 3, axis=1) if faces is None else faces[index]
    brightness = _brightness(raster, seen, corners, weights, normals) * _rims(raster)[seen]
    if isinstance(colours, np.ndarray):
        tint = np.einsum("nk,nkd->nd", weights, colours[corners])
    else:
        tint = np.broadcast_to(colours, (len(index), 3))
    picture = np.empty((*seen.shape, 3))
    picture[:] = background
    picture[seen] = np.clip(brightness[:, None] * tint, 0, 1)
    return picture


def _brightness(
    raster: Raster, seen: np.ndarray, corners: np.ndarray, weights: np.ndarray, normals: np.ndarray | None
) -> Float[np.ndarray, " n"]:
    total = _AMBIENT + sum(strength for _, strength in _LIGHTS)
    if normals is None:
        return np.full(len(corners), 0.9 * total)
    camera = raster.camera
    turned = np.einsum("nk,nkd->nd", weights, normals[corners]) @ camera.T_camera_world[:3, :3].T
    length = np.linalg.norm(turned, axis=1, keepdims=True)
    turned = np.divide(turned, length, out=np.zeros_like(turned), where=length > 0)
    rows, columns = np.nonzero(seen)
    pixels = np.stack([columns + 0.5, rows + 0.5], axis=1)
    ray = np.concatenate([(pixels - camera.centre) / camera.focal, np.ones((len(rows), 1))], axis=1)
    # The side that is seen is the side that is lit: scans are open, and normals may be flipped.
    away = np.einsum("nd,nd->n", turned, ray) > 0
    turned[away] *= -1
    brightness = np.full(len(corners), _AMBIENT)
    for direction, strength in _LIGHTS:
        brightness += strength * np.clip(turned @ (np.array(direction) / np.linalg.norm(direction)), 0, None)
    return brightness


def _rims(raster: Raster) -> Float[np.ndarray, "H W"]:
    """Factor per pixel, below 1 beside a nearer surface."""
    depth = np.where(raster.covered, raster.depth, np.inf)
    padded = np.pad(depth, 2, mode="edge")
    height, width = depth.shape
    occlusion = np.zeros_like(depth)
    for down, right in ((0, 2), (4, 2), (2, 0), (2, 4), (1, 1), (1, 3), (3, 1), (3, 3)):
        neighbour = padded[down : down + height, right : right + width]
        with np.errstate(invalid="ignore"):
            behind = depth - neighbour
        occlusion += np.clip(np.nan_to_num(behind, nan=0, posinf=0, neginf=0) / _EDGE_DEPTH, 0, 1)
    return 1 - _EDGE_STRENGTH * occlusion / 8
