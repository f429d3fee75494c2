"""Pictures of a scan from virtual cameras, made to look like what a hand detector was trained on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8
from scipy.spatial import cKDTree

from corporeal.geometry.cameras import Pinhole
from corporeal.geometry.rasteriser import rasterise, shade, splat
from corporeal.scans.scan import Scan

# Flat shading with a skin-like tint on a plain background, whatever the scan's own colours: those are often
# false colours or none.
SKIN = (0.86, 0.66, 0.54)
BACKGROUND = (0.42, 0.45, 0.50)
_DISC_NEIGHBOURS = 6
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

    def picture(self, camera: Pinhole) -> UInt8[np.ndarray, "H W 3"]:
        """The scan as one camera sees it."""
        scan = self.scan
        if self.radii is not None:
            raster = splat(scan.points, scan.normals, camera, self.radii)
            return shade(raster, scan.points, None, None, SKIN, background=BACKGROUND)
        raster = rasterise(scan.points, scan.faces, camera)
        return shade(raster, scan.points, scan.faces, None, SKIN, background=BACKGROUND)
