"""A small software rasteriser: z-buffer of triangles or discs, and plain Lambert shading."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numba
import numpy as np
from jaxtyping import Float, Int, Int32, UInt8

from corporeal.geometry import rasteriser_kernels as kernels
from corporeal.geometry.cameras import Pinhole

WHITE = (1.0, 1.0, 1.0)
GREY = (0.7, 0.7, 0.7)


@dataclass(frozen=True, eq=False)
class Raster:
    """What every pixel of one camera sees.

    Attributes:
        camera: the camera.
        depth: (H, W) z in the camera's frame, metres; infinite where nothing is seen.
        face: (H, W) index of the visible face (of the point for ``splat``); -1 where nothing is seen.
        barycentric: (H, W, 3) perspective-correct weights of the face's corners; zero where nothing is seen.
        normals: (H, W, 3) world, of any length: blended over neighbouring discs by ``splat``; None for faces.
    """

    camera: Pinhole
    depth: Float[np.ndarray, "H W"]
    face: Int32[np.ndarray, "H W"]
    barycentric: Float[np.ndarray, "H W 3"]
    normals: Float[np.ndarray, "H W 3"] | None = None

    @property
    def covered(self) -> np.ndarray:
        """(H, W) where anything is seen."""
        return self.face >= 0


def rasterise(
    vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], camera: Pinhole, near: float = 1e-3
) -> Raster:
    """Which face each pixel's centre sees.

    A pixel belongs to a face when the ray through its centre meets the face, edges included; of several the
    nearest wins, at equal depth the one with the lower index. Both windings are drawn. Faces that pass the
    near plane are cut there per pixel.

    Args:
        vertices: world points, metres.
        faces: corner indices.
        camera: the view.
        near: smallest depth that is drawn, metres, > 0.

    Raises:
        ValueError: face indices outside the vertices, or ``near`` not positive.
    """
    _check_near(near)
    if faces.size and (faces.min() < 0 or faces.max() >= len(vertices)):
        raise ValueError(f"faces: indices must lie in 0..{len(vertices) - 1}")
    local = np.ascontiguousarray(camera.to_camera(np.asarray(vertices, np.float64)))
    depth, face = _blank(camera)
    size = np.array([camera.width, camera.height])
    edges, boxes = kernels.triangle_setup(local, np.ascontiguousarray(faces), camera.lens, size, near)
    kernels.fill_triangles(edges, boxes, camera.lens, near, depth, face, numba.get_num_threads())
    barycentric = np.zeros((*face.shape, 3))
    kernels.barycentric_weights(edges, face, camera.lens, barycentric)
    return Raster(camera, depth, face, barycentric)


def splat(
    points: Float[np.ndarray, "N 3"],
    normals: Float[np.ndarray, "N 3"] | None,
    camera: Pinhole,
    radius: float | Float[np.ndarray, " N"],
    near: float = 1e-3,
) -> Raster:
    """Draws points as flat discs across their normals; ``Raster.face`` then holds point indices.

    Where discs overlap, their normals are blended, so that a coarse cloud is shaded like the surface it was
    sampled from (the idea of surface splatting, Zwicker et al. 2001, without its filter).

    Args:
        points: world points, metres.
        normals: outward, of unit length; rows of zeros, or None, make the discs face the camera.
        camera: the view.
        radius: of every disc or of each, metres.
        near: smallest depth that is drawn, metres, > 0; discs that reach it are left out.

    Raises:
        ValueError: ``radius`` or ``near`` not positive.
    """
    _check_near(near)
    radii = np.broadcast_to(np.asarray(radius, np.float64), len(points)).copy()
    if not (radii > 0).all():
        raise ValueError("radius: must be positive")
    local = np.ascontiguousarray(camera.to_camera(np.asarray(points, np.float64)))
    turned = np.zeros_like(local)
    if normals is not None:
        turned[:] = normals @ camera.T_camera_world[:3, :3].T
    depth, index = _blank(camera)
    threads = numba.get_num_threads()
    kernels.fill_discs(local, turned, radii, camera.lens, near, depth, index, threads)
    barycentric = np.zeros((*index.shape, 3))
    barycentric[index >= 0, 0] = 1.0
    if normals is None:
        return Raster(camera, depth, index, barycentric)
    # Sums over the camera's frame, turned back below: one frame for all of Raster.
    blended = np.zeros((*index.shape, 3))
    kernels.blend_normals(local, turned, radii, camera.lens, near, depth, blended, threads)
    return Raster(camera, depth, index, barycentric, blended @ camera.T_camera_world[:3, :3])


def shade(
    raster: Raster,
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"] | None,
    normals: Float[np.ndarray, "V 3"] | None = None,
    colours: Float[np.ndarray, "V 3"] | tuple[float, float, float] = GREY,
    light: Literal["headlight"] | Float[np.ndarray, 3] = "headlight",
    background: tuple[float, float, float] = WHITE,
) -> UInt8[np.ndarray, "H W 3"]:
    """Lambert shading, lit from both sides of the surface, with a quarter of ambient light.

    Args:
        raster: what the camera sees.
        vertices: the world points that were drawn.
        faces: the faces that were drawn; None for a raster of points.
        normals: per vertex for smooth shading; None: faces are flat, points take the raster's normals.
        colours: per vertex or one for all, 0..1.
        light: "headlight" at the camera, or the direction towards a far light in the camera's frame.
        background: colour of pixels that see nothing, 0..1.

    Returns:
        An RGB picture.
    """
    seen = raster.covered
    index, weights = raster.face[seen], raster.barycentric[seen]
    corners = np.repeat(index[:, None], 3, axis=1) if faces is None else faces[index]
    local = raster.camera.to_camera(np.asarray(vertices, np.float64))
    points = np.einsum("nk,nkd->nd", weights, local[corners])
    to_eye = -_unit(points)
    R_camera_world = raster.camera.T_camera_world[:3, :3]
    if normals is not None:
        turned = np.einsum("nk,nkd->nd", weights, normals[corners]) @ R_camera_world.T
    elif raster.normals is not None:
        turned = raster.normals[seen] @ R_camera_world.T
    elif faces is None:
        turned = to_eye
    else:
        a, b, c = (local[corners[:, k]] for k in range(3))
        turned = np.cross(b - a, c - a)
    turned = _unit(turned)
    # The side of the surface that is seen is the side that is lit.
    turned = np.where((turned * to_eye).sum(1, keepdims=True) < 0, -turned, turned)
    to_light = to_eye if isinstance(light, str) else _unit(np.asarray(light, np.float64)[None])
    brightness = 0.25 + 0.75 * np.clip((turned * to_light).sum(1), 0, 1)
    tint = np.einsum("nk,nkd->nd", weights, colours[corners]) if isinstance(colours, np.ndarray) else colours
    picture = np.empty((*seen.shape, 3))
    picture[:] = background
    picture[seen] = brightness[:, None] * np.asarray(tint)
    return (np.clip(picture, 0, 1) * 255 + 0.5).astype(np.uint8)


def flat_picture(
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    camera: Pinhole,
    colour: tuple[float, float, float] = GREY,
    background: tuple[float, float, float] = WHITE,
    near: float = 1e-3,
) -> UInt8[np.ndarray, "H W 3"]:
    """A mesh in one colour with flat faces, lit from the camera.

    The same picture as ``shade(rasterise(...))`` with its defaults, in a fifth of the time: a detector is
    shown dozens of them per scan. Arguments and errors as there.
    """
    _check_near(near)
    if faces.size and (faces.min() < 0 or faces.max() >= len(vertices)):
        raise ValueError(f"faces: indices must lie in 0..{len(vertices) - 1}")
    local = np.ascontiguousarray(camera.to_camera(np.asarray(vertices, np.float64)))
    depth, face = _blank(camera)
    size = np.array([camera.width, camera.height])
    edges, boxes = kernels.triangle_setup(local, np.ascontiguousarray(faces), camera.lens, size, near)
    kernels.fill_triangles(edges, boxes, camera.lens, near, depth, face, numba.get_num_threads())
    # The sum of a triangle's edge functions is its normal.
    normals = edges[:, 0:3] + edges[:, 3:6] + edges[:, 6:9]
    picture = np.empty((*face.shape, 3), np.uint8)
    picture[:] = (np.clip(background, 0, 1) * 255 + 0.5).astype(np.uint8)
    kernels.headlight(face, normals, camera.lens, 255 * np.asarray(colour, np.float64), picture)
    return picture


def _blank(camera: Pinhole) -> tuple[np.ndarray, np.ndarray]:
    shape = (camera.height, camera.width)
    return np.full(shape, np.inf), np.full(shape, -1, np.int32)


def _check_near(near: float) -> None:
    if not near > 0:
        raise ValueError(f"near: must be positive, got {near}")


def _unit(vectors: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return vectors / np.where(length > 0, length, 1)
