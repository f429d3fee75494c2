"""Surface vertices to the scan: the term E_g' of Romero et al. 2017, equation 15.

It keeps the model from reaching where nothing was seen (fingers too long), and harms where the scan has
holes: vertices whose closest scan point lies on the edge of a hole are therefore not matched.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from corporeal.geometry.closest_points import SurfaceTree
from corporeal.geometry.normals import vertex_normals
from corporeal.solve.curvature import Curvature
from corporeal.solve.problem import Fields, Quadratic
from corporeal.terms.distance import DistanceOptions, WeightedDistances
from corporeal.terms.scan_to_surface import MovingSurface


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

    def at(self, fields: Fields) -> SurfaceToScanValue:
        """Find closest scan points; the faces found start the next search."""
        vertices = fields[self.field]
        closest = self.scan.tree.closest(vertices, self._last_faces)
        self._last_faces = closest.faces
        normals = self.scan.normals[closest.faces]
        on_edge = ((closest.barycentric < 1e-9) & self.scan.boundary_sides[closest.faces]).any(axis=1)
        offsets = vertices - closest.points
        weights = self.weights
        if self.outside:
            beyond = np.einsum("na,na->n", offsets, normals) > 0
            far = np.einsum("na,na->n", offsets, offsets) > self.sticking_out**2
            matched = beyond & (~on_edge | far)
            weights = np.where(matched, weights, 0.0)
        else:
            own = vertex_normals(vertices, self.surface.faces)
            matched = ~on_edge & (np.einsum("na,na->n", own, normals) >= self.options.minimum_cosine)
        distances = WeightedDistances.of(offsets, weights, matched, self.options)
        return SurfaceToScanValue(self, distances, normals)


@dataclass(frozen=True, eq=False)
class SurfaceToScanValue:
    """The term at one surface."""

    term: SurfaceToScan
    distances: WeightedDistances
    scan_normals: Float[np.ndarray, "V 3"]

    @property
    def cost(self) -> float:
        """Half the sum of weighted robust squared distances, in units of sigma squared."""
        return self.distances.cost

    def quadratic(self) -> Quadratic:
        """Gradient of the distance itself; curvature with the closest points held fixed."""
        field, pattern = self.term.field, self.term.surface.pattern
        gradient = self.distances.weights[:, None] * self.distances.offsets
        curvature: Curvature
        if self.distances.is_per_axis:
            curvature = pattern.diagonal(self.distances.weights)
        else:
            curvature = pattern.diagonal_blocks(self.distances.metric(self.scan_normals))
        return Quadratic({field: gradient}, {(field, field): curvature})
