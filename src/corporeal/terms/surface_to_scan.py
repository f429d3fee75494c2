"""Surface vertices to the scan: the term E_g' of Romero et al. 2017, equation 15.

It keeps the model from reaching where nothing was seen (fingers too long), and harms where the scan has
holes: vertices whose closest scan point lies on the edge of a hole are therefore not matched.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from corporeal.geometry.closest_points import SurfaceTree
from corporeal.geometry.clustering import clustered
from corporeal.geometry.normals import face_normals, vertex_normals
from corporeal.geometry.topology import open_sides
from corporeal.solve.curvature import Curvature
from corporeal.solve.problem import Fields, Quadratic
from corporeal.terms.distance import DistanceOptions, WeightedDistances
from corporeal.terms.scan_to_surface import MovingSurface

# What lies so far (metres) from the edge of a hole sticks out of it; nearer, it may just not have been seen.
STICKING_OUT = 12e-3


@dataclass(frozen=True, eq=False)
class ScanSurface:
    """A fixed scan surface to measure against.

    Attributes:
        tree: search tree of its triangles.
        normals: (M, 3) unit normals of its faces.
        boundary_sides: (M, 3) which sides of its faces are open.
    """

    tree: SurfaceTree
    normals: Float[np.ndarray, "M 3"]
    boundary_sides: Bool[np.ndarray, "M 3"]

    @classmethod
    def of_mesh(
        cls, points: Float[np.ndarray, "N 3"], faces: Int[np.ndarray, "_ 3"], most: int
    ) -> ScanSurface:
        """A mesh's triangles, with at most about ``most`` points where it has more."""
        points, faces = clustered(points, faces, most)
        return cls(SurfaceTree(points, faces), face_normals(points, faces), open_sides(faces))


@dataclass(eq=False)
class SurfaceToScan:
    """Squared robust distances of surface vertices to a scan.

    Attributes:
        name: of the term.
        field: the field (V, 3) that holds the vertices, metres.
        surface: the moving surface's topology.
        scan: the fixed scan.
        weights: (V,) base weights; zero leaves a vertex out.
        options: sigma, robust scale, curvature.
        outside: only vertices on the outer side of the scan count, the others cost nothing, and normals
            are not compared: skin within may be skin that nothing saw, of folded fingers say. A third of
            a fist's vertices lie so, and a pose that hides none looks better by them, however wrong it is.
        sticking_out: with ``outside``, vertices whose closest point is the edge of a hole count where they
            are farther than this from it, metres: fingers that stick out of a hole. Infinite where what is
            missing may have been there.
    """

    name: str
    field: str
    surface: MovingSurface
    scan: ScanSurface
    weights: Float[np.ndarray, " V"]
    options: DistanceOptions
    outside: bool = False
    sticking_out: float = np.inf
    _last_faces: np.ndarray | None = None

    @cached_property
    def _asked(self) -> Int[np.ndarray, " n"]:
        """Vertices that weigh anything: only for these the scan is searched."""
        return np.flatnonzero(self.weights)

    def at(self, fields: Fields) -> SurfaceToScanValue:
        """Find closest scan points; the faces found start the next search."""
        asked, vertices = self._asked, fields[self.field][self._asked]
        closest = self.scan.tree.closest(vertices, self._last_faces)
        self._last_faces = closest.faces
        normals = self.scan.normals[closest.faces]
        on_edge = ((closest.barycentric < 1e-9) & self.scan.boundary_sides[closest.faces]).any(axis=1)
        offsets = vertices - closest.points
        weights = self.weights[asked]
        if self.outside:
            beyond = np.einsum("na,na->n", offsets, normals) > 0
            far = np.einsum("na,na->n", offsets, offsets) > self.sticking_out**2
            matched = beyond & (~on_edge | far)
            weights = np.where(matched, weights, 0.0)
        else:
            own = vertex_normals(fields[self.field], self.surface.faces)[asked]
            matched = ~on_edge & (np.einsum("na,na->n", own, normals) >= self.options.minimum_cosine)
        distances = WeightedDistances.of(offsets, weights, matched, self.options)
        return SurfaceToScanValue(self, asked, distances, normals)


@dataclass(frozen=True, eq=False)
class SurfaceToScanValue:
    """The term at one surface; distances and normals are of the vertices that were asked."""

    term: SurfaceToScan
    asked: Int[np.ndarray, " n"]
    distances: WeightedDistances
    scan_normals: Float[np.ndarray, "n 3"]

    @property
    def cost(self) -> float:
        """Half the sum of weighted robust squared distances, in units of sigma squared."""
        return self.distances.cost

    def quadratic(self) -> Quadratic:
        """Gradient of the distance itself; curvature with the closest points held fixed."""
        field, pattern = self.term.field, self.term.surface.pattern
        count = len(self.term.weights)
        gradient = np.zeros((count, 3))
        gradient[self.asked] = self.distances.weights[:, None] * self.distances.offsets
        curvature: Curvature
        if self.distances.is_per_axis:
            diagonal = np.zeros(count)
            diagonal[self.asked] = self.distances.weights
            curvature = pattern.diagonal(diagonal)
        else:
            blocks = np.zeros((count, 3, 3))
            blocks[self.asked] = self.distances.metric(self.scan_normals)
            curvature = pattern.diagonal_blocks(blocks)
        return Quadratic({field: gradient}, {(field, field): curvature})
