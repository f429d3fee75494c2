"""Pictures of a scan from virtual cameras, made to look like what a hand detector was trained on."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, UInt8
from scipy.spatial import cKDTree

from corporeal.geometry.cameras import Pinhole
from corporeal.geometry.clustering import clustered
from corporeal.geometry.rasteriser import flat_picture, shade, splat
from corporeal.geometry.triangulation import Triangulation, robust_triangulation
from corporeal.scans.scan import Scan

# Flat shading with a skin-like tint on a plain background, whatever the scan's own colours: those are often
# false colours or none.
SKIN = (0.86, 0.66, 0.54)
BACKGROUND = (0.42, 0.45, 0.50)
_DISC_NEIGHBOURS = 6
# A hand of 12,000 points has triangles of 3 pixels; the detector finds the same as with 50,000.
_DRAWN_POINTS = 12_000
# Metres, on a hand; a bound for very dense scans; the steps inward and outward of every round.
_SMOOTHED_OVER, _MOST_ROUNDS, _TAUBIN = 0.004, 20, (0.5, -0.53)
FIELD_OF_VIEW = np.deg2rad(35.0)


def cameras_around(
    points: Float[np.ndarray, "N 3"],
    directions: Float[np.ndarray, "C 3"],
    up: Float[np.ndarray, "3"],
    *,
    size: int,
    fill: float,
) -> list[Pinhole]:
    """One camera per viewing direction, framing the points; ``up`` is where the fingers should point."""
    return [
        Pinhole.fit_to_frame(points, direction, up, fov=FIELD_OF_VIEW, size=(size, size), fill=fill)
        for direction in directions
    ]


def ring(axis: Float[np.ndarray, "3"], count: int, tilts: tuple[float, ...]) -> Float[np.ndarray, "C 3"]:
    """Viewing directions round an axis: ``count`` per tilt (radians above the plane across the axis)."""
    axis = axis / np.linalg.norm(axis)
    first = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    first /= np.linalg.norm(first)
    second = np.cross(axis, first)
    directions = []
    for row, tilt in enumerate(tilts):
        angles = 2 * np.pi * (np.arange(count) + 0.5 * (row % 2)) / count
        across = np.cos(angles)[:, None] * first + np.sin(angles)[:, None] * second
        directions.append(np.cos(tilt) * across + np.sin(tilt) * axis)
    return np.concatenate(directions)


def upright_candidates(points: Float[np.ndarray, "N 3"]) -> Iterator[Float[np.ndarray, "3"]]:
    """Directions that may be up, likely ones first: scanners write y or z, and people are long."""
    axes = np.eye(3)
    yield from (axes[1], axes[2], -axes[1], -axes[2], axes[0], -axes[0])
    centred = points - points.mean(0)
    longest = np.linalg.eigh(centred.T @ centred)[1][:, 2]
    yield from (longest, -longest)


def triangulated(
    cameras: list[Pinhole], pixels: Float[np.ndarray, "C N 2"], tolerance: float
) -> Triangulation | None:
    """What views agree on within so many pixels; None of fewer than two, or where none agree."""
    if len(cameras) < 2:
        return None
    return robust_triangulation(np.array([camera.projection for camera in cameras]), pixels, tolerance)


def spread_in_metres(cameras: list[Pinhole], found: Triangulation) -> Float[np.ndarray, " N"]:
    """How far the agreeing views disagree about each point: median residual at the point's mean depth."""
    used = np.flatnonzero(found.agreeing)
    per_pixel = [cameras[c].project(found.points)[1] / cameras[c].focal[0] for c in used]
    return np.median(found.residuals[used], axis=0) * np.mean(per_pixel, axis=0)


@dataclass(frozen=True, eq=False)
class Subject:
    """A scan made ready to be drawn many times.

    Attributes:
        scan: mesh or point cloud.
        radii: (N,) disc sizes of a point cloud's points, metres; None for a mesh.
    """

    scan: Scan
    radii: Float[np.ndarray, " N"] | None

    @classmethod
    def of_scan(cls, scan: Scan) -> Subject:
        """Sizes the discs of a point cloud so that neighbours overlap: holes let the detector see noise."""
        if not scan.is_point_cloud:
            return cls(scan, None)
        count = min(_DISC_NEIGHBOURS, len(scan.points) - 1)
        if count < 1:
            return cls(scan, np.full(len(scan.points), 1e-3))
        distances = cKDTree(scan.points).query(scan.points, k=count + 1, workers=-1)[0]
        return cls(scan, np.maximum(distances[:, -1], 1e-5))

    def smoothed(self) -> Subject:
        """The same with noise taken off: flat faces of a noisy scan look like gravel, and show no hand.

        Positions are smoothed, not normals: those of neighbouring noisy faces are nearly random. Not used
        where the plain scan will do: the creases between closed fingers go with the noise.
        """
        if self.scan.is_point_cloud:
            return self
        points = _without_noise(self.scan)
        return Subject(dataclasses.replace(self.scan, points=points), None)

    def picture(self, camera: Pinhole) -> UInt8[np.ndarray, "H W 3"]:
        """The scan as one camera sees it."""
        scan = self.scan
        if self.radii is not None:
            raster = splat(scan.points, scan.normals, camera, self.radii)
            return shade(raster, scan.points, None, None, SKIN, background=BACKGROUND)
        points, faces = self._coarse
        return flat_picture(points, faces, camera, SKIN, BACKGROUND)

    @property
    def outline(self) -> Float[np.ndarray, "W 3"]:
        """Points that tell where the scan is, for framing: those that are drawn of a mesh, all of a cloud."""
        return self.scan.points if self.radii is not None else self._coarse[0]

    @cached_property
    def _coarse(self) -> tuple[np.ndarray, np.ndarray]:
        """What is drawn of a mesh: scanners give more triangles than the pictures have pixels on the hand."""
        return clustered(self.scan.points, self.scan.faces, _DRAWN_POINTS)


def _without_noise(scan: Scan) -> Float[np.ndarray, "N 3"]:
    """Points smoothed over ``_SMOOTHED_OVER``, without shrinking (Taubin 1995)."""
    edges = np.concatenate([scan.faces[:, [0, 1]], scan.faces[:, [1, 2]], scan.faces[:, [2, 0]]])
    length = float(np.median(np.linalg.norm(scan.points[edges[:, 0]] - scan.points[edges[:, 1]], axis=1)))
    rounds = int(np.clip((_SMOOTHED_OVER / max(length, 1e-6)) ** 2, 2, _MOST_ROUNDS))
    count = len(scan.points)
    both = np.concatenate([edges, edges[:, ::-1]])
    links = sp.csr_matrix((np.ones(len(both)), (both[:, 0], both[:, 1])), shape=(count, count))
    degree = np.maximum(np.asarray(links.sum(axis=1)), 1.0)
    linked = np.asarray(links.sum(axis=1)) > 0
    points = scan.points
    for _ in range(rounds):
        for step in _TAUBIN:
            points = points + np.where(linked, step * (links @ points / degree - points), 0.0)
    return np.ascontiguousarray(points)
