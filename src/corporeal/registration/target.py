"""What the stages fit to: points sampled on a scan, and the scan's own surface."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float

from corporeal.geometry.normals import face_areas
from corporeal.scans.flat_patches import flat_patch
from corporeal.scans.scan import Scan
from corporeal.scans.surface_sampling import sample_surface
from corporeal.terms.surface_to_scan import ScanSurface


@dataclass(frozen=True, eq=False)
class SampledPoints:
    """Points on a scan with unit normals; normals are None where a point cloud's are only guessed."""

    positions: Float[np.ndarray, "n 3"]
    normals: Float[np.ndarray, "n 3"] | None

    def kept(self, mask: Bool[np.ndarray, " n"]) -> SampledPoints:
        """The points of a mask."""
        return SampledPoints(self.positions[mask], None if self.normals is None else self.normals[mask])

    def first(self, count: int) -> SampledPoints:
        """At most ``count`` points, evenly taken."""
        if len(self.positions) <= count:
            return self
        picked = np.linspace(0, len(self.positions) - 1, count).astype(np.int64)
        return SampledPoints(self.positions[picked], None if self.normals is None else self.normals[picked])


# The surface that the model's vertices are pulled to. The model has 3,000 of them and the pull is robust over
# 5 mm and more: beyond this many points a scan's detail costs time only (0.2 s of a scan with 50,000).
SURFACE_POINTS = 12_000


class Target:
    """A scan prepared for fitting; samples and search tree are made once and kept."""

    def __init__(self, scan: Scan, *, seed: int = 0) -> None:
        self.scan = scan
        self._seed = seed

    def scaled(self, factor: float) -> Target:
        """The same scan with another estimate of its scale; itself where the factor is 1."""
        if factor == 1.0:
            return self
        return Target(self.scan.with_scale(self.scan.unit.metres_per_unit * factor), seed=self._seed)

    @cached_property
    def measured(self) -> Scan:
        """The scan without a flat cut: faces that closed it where nothing was seen, or a table."""
        flat = flat_patch(self.scan)
        if not flat.any():
            return self.scan
        areas = face_areas(self.scan.points, self.scan.faces)
        share = areas[flat].sum() / areas.sum()
        sentence = f"A flat patch ({share:.0%} of the area) is no skin and was not fitted to."
        return dataclasses.replace(self.scan, faces=self.scan.faces[~flat]).with_repair(sentence)

    @cached_property
    def samples(self) -> SampledPoints:
        """Points spread over the scan's area, in random order."""
        points, normals = sample_surface(self.measured, 40_000, seed=self._seed)
        return SampledPoints(points, None if self.scan.is_point_cloud else normals)

    @cached_property
    def surface(self) -> ScanSurface | None:
        """The scan's triangles, fewer where it has many, or None for a point cloud."""
        scan = self.measured
        if scan.is_point_cloud:
            return None
        return ScanSurface.of_mesh(scan.points, scan.faces, SURFACE_POINTS)
