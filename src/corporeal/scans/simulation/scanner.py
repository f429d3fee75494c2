"""A virtual 4D scanner: stereo units, occlusion, depth noise, holes, one fused and meshed scan."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float, Int, UInt8
from scipy.sparse.csgraph import connected_components

from corporeal.geometry.cameras import Pinhole
from corporeal.geometry.normals import face_vectors, vertex_normals
from corporeal.geometry.rasteriser import rasterise
from corporeal.scans.simulation import scanner_kernels as kernels
from corporeal.scans.simulation.sampling_pattern import SamplingPattern

_SHADOW = 0.6e-3  # metres behind the nearest surface at which a point counts as hidden
_BRIGHTNESS_NOISE, _COLOUR_NOISE = 2.5, 0.8  # of 255
_FEW_FACES = 40  # smaller islands are dropped, as the makers' software does


@dataclass(frozen=True, eq=False)
class SampledSurface:
    """A surface to be scanned: vertices (V, 3) metres, faces (F, 3), colours (V, 3) 0-255, and a pattern.

    The pattern says where points fall. The pattern lives on the faces, so it follows a surface that deforms.

    Attributes:
        lost: (n,) points of the pattern that the scanner fails to measure.
        noise: (n,) noise of the pattern's points against the scanner's own; None for one.
    """

    vertices: Float[np.ndarray, "V 3"]
    faces: Int[np.ndarray, "F 3"]
    colours: Float[np.ndarray, "V 3"]
    pattern: SamplingPattern
    lost: Bool[np.ndarray, " n"] | None = None
    noise: Float[np.ndarray, " n"] | None = None


# Azimuth and elevation of five units in degrees, round a hand that points up.
_HAND_UNITS = ((0.0, 15.0), (75.0, 5.0), (150.0, 25.0), (215.0, 5.0), (290.0, 20.0))


@dataclass(frozen=True)
class ScannerOptions:
    """The scanner.

    Attributes:
        noise: root mean square distance of points from the surface along the line of sight, metres.
        distance: of the units from the subject, metres; ``baseline`` between a unit's two cameras.
        steepest: degrees between normal and line of sight beyond which stereo finds nothing.
        pixels: of a camera's picture, either way.
        jitter: how far points move within their faces, as a share of the way to a random point of the face.
        ragged: share of the points at the edge of a hole that are lost too.
        units: azimuth and elevation of every stereo unit, degrees.
        reach: half the side of what a camera sees at the subject, metres.
        up: axis that points up.
    """

    noise: float = 0.2e-3
    distance: float = 0.75
    baseline: float = 0.16
    steepest: float = 72.0
    pixels: int = 520
    jitter: float = 0.2
    ragged: float = 0.35
    units: tuple[tuple[float, float], ...] = _HAND_UNITS
    reach: float = 0.17
    up: Literal["y", "z"] = "z"


@dataclass(frozen=True, eq=False)
class RawCapture:
    """A meshed scan: noisy points (N, 3) in metres, faces (M, 3), colours (N, 3), points without noise.

    Attributes:
        samples: (N,) number of each point in the surfaces' patterns, one after the other.
    """

    points: Float[np.ndarray, "N 3"]
    faces: Int[np.ndarray, "M 3"]
    colours: UInt8[np.ndarray, "N 3"]
    clean: Float[np.ndarray, "N 3"]
    samples: Int[np.ndarray, " N"]


def scan_surface(
    subject: SampledSurface,
    props: Sequence[SampledSurface],
    options: ScannerOptions,
    generator: np.random.Generator,
) -> RawCapture:
    """Scan a subject and what stands beside it.

    Args:
        subject: posed, in the scanner's frame; it is in the middle of the pictures.
        props: objects and stands; they hide and are scanned too.
        options: the scanner.
        generator: the same state gives the same scan.
    """
    surfaces = [subject, *props]
    parts = [_sampled(surface, options.jitter, generator) for surface in surfaces]
    points, normals, colours = (np.concatenate([part[k] for part in parts]) for k in range(3))
    triangles = _joined([surface.pattern.triangles for surface in surfaces], [len(part[0]) for part in parts])
    scene = np.concatenate([surface.vertices for surface in surfaces])
    scene_faces = _joined([s.faces for s in surfaces], [len(s.vertices) for s in surfaces])
    direction, cosine = _measured(points, normals, scene, scene_faces, subject.vertices, options)
    seen = (cosine > 0) & ~np.concatenate([_lost(surface) for surface in surfaces])
    seen &= ~_ragged(triangles, seen, options.ragged, generator)
    noise = _noise(triangles, cosine, seen, options.noise, generator)
    noisy = points + direction * (noise * np.concatenate([_noisiness(s) for s in surfaces]))[:, None]
    light = 0.55 + 0.45 * np.clip(normals @ (np.array([0.2, 0.35, 0.9]) @ _axes(options.up)), -0.6, 1)
    shade = colours * light[:, None] + _sensor_noise(len(colours), generator)
    whole = triangles[seen[triangles].all(axis=1)]
    # A triangle that the moved points turned over is none that a scanner makes.
    facing = np.einsum("ma,ma->m", face_vectors(points, whole), normals[whole].sum(1)) > 0
    kept, faces = _pieces(whole[facing], len(points))
    # Places in the list must not tell where on the hand a point lies.
    shuffle = generator.permutation(len(kept))
    place = np.empty(len(kept), dtype=np.int64)
    place[shuffle] = np.arange(len(kept))
    kept, faces = kept[shuffle], generator.permutation(place[faces])
    rounded = np.clip(np.round(shade[kept]), 0, 255).astype(np.uint8)
    return RawCapture(noisy[kept], faces, rounded, points[kept], kept)


def _lost(surface: SampledSurface) -> np.ndarray:
    return np.zeros(len(surface.pattern.faces), dtype=bool) if surface.lost is None else surface.lost


def _noisiness(surface: SampledSurface) -> np.ndarray:
    return np.ones(len(surface.pattern.faces)) if surface.noise is None else surface.noise


def _axes(up: Literal["y", "z"]) -> Float[np.ndarray, "3 3"]:
    """Two level directions and that which points up, as rows; right-handed."""
    return np.eye(3)[[0, 1, 2] if up == "z" else [2, 0, 1]]


def _sampled(
    surface: SampledSurface, jitter: float, generator: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    corners = surface.faces[surface.pattern.faces]
    weights = surface.pattern.jittered(jitter, generator)[..., None]
    normals = vertex_normals(surface.vertices, surface.faces)
    points, normals, colours = (
        (weights * values[corners]).sum(1) for values in (surface.vertices, normals, surface.colours)
    )
    return points, normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9), colours


def _joined(faces: list[np.ndarray], counts: list[int]) -> np.ndarray:
    shifts = np.concatenate([[0], np.cumsum(counts)[:-1]])
    return np.concatenate([part + shift for part, shift in zip(faces, shifts, strict=True)]).astype(np.int64)


def stereo_units(centre: Float[np.ndarray, "3"], options: ScannerOptions) -> list[tuple[Pinhole, Pinhole]]:
    """The two cameras of every unit, looking at a centre."""
    units = []
    axes = _axes(options.up)
    for azimuth, elevation in np.deg2rad(np.array(options.units)):
        flat = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
        away = np.cos(elevation) * flat + np.sin(elevation) * np.array([0, 0, 1.0])
        eye = centre + options.distance * away @ axes
        side = 0.5 * options.baseline * np.array([-flat[1], flat[0], 0.0]) @ axes
        angle = 2 * np.arctan(options.reach / options.distance)
        pair = [
            Pinhole.look_at(eye + sign * side, centre, axes[2], angle, (options.pixels,) * 2)
            for sign in (-1, 1)
        ]
        units.append((pair[0], pair[1]))
    return units


def _measured(
    points: np.ndarray, normals: np.ndarray, scene: np.ndarray, faces: np.ndarray, subject: np.ndarray,
    options: ScannerOptions,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Line of sight and cosine of the unit that measures a point best; zero where none sees it twice."""
    best, direction = np.zeros(len(points)), np.zeros_like(points)
    limit = np.cos(np.deg2rad(options.steepest))
    centre = (subject.min(0) + subject.max(0)) / 2
    for pair in stereo_units(centre, options):
        cosine = np.full(len(points), np.inf)
        for camera in pair:
            depth = rasterise(scene, faces, camera).depth
            T = camera.T_camera_world
            seen = kernels.seen_cosines(
                points, normals, T[:3, :3].copy(), T[:3, 3].copy(), camera.lens, camera.eye, depth, _SHADOW
            )
            cosine = np.minimum(cosine, seen)
        better = (cosine > best) & (cosine > limit)
        away = (pair[0].eye + pair[1].eye) / 2 - points[better]
        direction[better] = away / np.linalg.norm(away, axis=1, keepdims=True)
        best[better] = cosine[better]
    return direction, best


def _noise(
    triangles: np.ndarray, cosine: np.ndarray, seen: np.ndarray, rms: float, generator: np.random.Generator
) -> np.ndarray:
    """Larger where the surface is seen obliquely, a little alike in neighbours; scaled to ``rms``."""
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    size = len(cosine)
    graph = sp.csr_matrix((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(size, size))
    white = generator.normal(size=size)
    degree = np.maximum(np.asarray(graph.sum(1)).ravel(), 1)
    noise = (white + 0.7 * (graph @ white) / np.sqrt(degree)) / np.sqrt(np.maximum(cosine, 0.2))
    return noise * rms / np.sqrt(np.mean(noise[seen] ** 2)) if seen.any() else noise


def _sensor_noise(count: int, generator: np.random.Generator) -> np.ndarray:
    """Mostly of brightness; that of colour is bounded, so that dark skin never turns green."""
    brightness = _BRIGHTNESS_NOISE * generator.normal(size=(count, 1))
    return brightness + np.clip(_COLOUR_NOISE * generator.normal(size=(count, 3)), -2.5, 2.5)


def _ragged(
    triangles: np.ndarray, seen: np.ndarray, share: float, generator: np.random.Generator
) -> np.ndarray:
    """Points lost at the edge of holes."""
    mixed = triangles[seen[triangles].any(1) & ~seen[triangles].all(1)]
    edge = np.zeros(len(seen), dtype=bool)
    edge[mixed] = True
    return edge & (generator.random(len(seen)) < share)


def _pieces(faces: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Points and faces without small islands."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]]])
    graph = sp.coo_matrix((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(count, count))
    _, piece = connected_components(graph, directed=False)
    sizes = np.bincount(piece[faces[:, 0]], minlength=piece.max(initial=0) + 1)
    kept = faces[sizes[piece[faces[:, 0]]] >= _FEW_FACES]
    used, renumbered = np.unique(kept, return_inverse=True)
    return used, renumbered.reshape(-1, 3).astype(np.int64)
