"""Scan points to the surface: the data term E_g of Romero et al. 2017, equation 6."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from corporeal.geometry.closest_points import ClosestPoints, SurfaceTree
from corporeal.geometry.normals import face_normals
from corporeal.geometry.topology import boundary_edges, open_sides, unique_edges
from corporeal.solve.curvature import Curvature
from corporeal.solve.problem import Fields, Quadratic
from corporeal.terms.distance import DistanceOptions, WeightedDistances
from corporeal.terms.mesh_pattern import MeshPattern


class MovingSurface:
    """A triangle surface whose vertices move: its search tree, sparsity and open boundary, made once."""

    def __init__(self, vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]) -> None:
        self.faces = np.asarray(faces, dtype=np.int64)
        self.tree = SurfaceTree(vertices, self.faces)
        self.pattern = MeshPattern(self.faces, len(vertices))
        self.boundary = boundary_edges(self.faces)
        self._on_boundary = open_sides(self.faces)
        self._asked: tuple[np.ndarray, np.ndarray] | None = None

    @cached_property
    def edges(self) -> Int[np.ndarray, "E 2"]:
        """Every edge once."""
        return unique_edges(self.faces)

    def closest(
        self, vertices: Float[np.ndarray, "V 3"], points: Float[np.ndarray, "n 3"], start: np.ndarray | None
    ) -> ClosestPoints:
        """Closest points with the surface moved to ``vertices``.

        The search starts at the faces ``start``. Without them it starts, where it is asked for the very same
        array of points again, where it ended: the answer is the same, and a frame's points are asked for at
        a dozen surfaces.
        """
        self.tree.refit(vertices)
        if start is not None:
            return self.tree.closest(points, start)
        if self._asked is not None and self._asked[0] is points:
            start = self._asked[1]
        closest = self.tree.closest(points, start)
        self._asked = points, closest.faces
        return closest

    def at_boundary(self, closest: ClosestPoints) -> Bool[np.ndarray, " n"]:
        """Which closest points lie on the open boundary: the point's own surface ended there."""
        return ((closest.barycentric < 1e-9) & self._on_boundary[closest.faces]).any(axis=1)


@dataclass(eq=False)
class ScanToSurface:
    """Squared robust distances of scan points to a surface.

    Attributes:
        name: of the term.
        field: the field (V, 3) that holds the surface's vertices, metres.
        surface: topology and search tree.
        points: (n, 3) metres.
        weights: (n,) base weights; their sum is the number of independent observations they stand for.
        normals: (n, 3) unit normals of the points, or None to match whatever is closest.
        options: sigma, robust scale, curvature.
        nearest: (n,) faces at which the next search starts: those found last, or at first what is known.
    """

    name: str
    field: str
    surface: MovingSurface
    points: Float[np.ndarray, "n 3"]
    weights: Float[np.ndarray, " n"]
    normals: Float[np.ndarray, "n 3"] | None
    options: DistanceOptions
    nearest: Int[np.ndarray, " n"] | None = None

    def at(self, fields: Fields) -> ScanToSurfaceValue:
        """Find closest points; the faces found start the next search."""
        vertices = fields[self.field]
        closest = self.surface.closest(vertices, self.points, self.nearest)
        self.nearest = closest.faces
        unit = face_normals(vertices, self.surface.faces)[closest.faces]
        matched = ~self.surface.at_boundary(closest)
        if self.normals is not None:
            matched &= np.einsum("na,na->n", unit, self.normals) >= self.options.minimum_cosine
        offsets = closest.points - self.points
        distances = WeightedDistances.of(offsets, self.weights, matched, self.options)
        return ScanToSurfaceValue(self, closest, distances, unit)


@dataclass(frozen=True, eq=False)
class ScanToSurfaceValue:
    """The term at one surface, with the closest points found."""

    term: ScanToSurface
    closest: ClosestPoints
    distances: WeightedDistances
    face_normals: Float[np.ndarray, "n 3"]

    @property
    def cost(self) -> float:
        """Half the sum of weighted robust squared distances, in units of sigma squared."""
        return self.distances.cost

    @cached_property
    def _curvature(self) -> Curvature:
        face, barycentric = self.closest.faces, self.closest.barycentric
        pattern = self.term.surface.pattern
        if self.distances.is_per_axis:
            return pattern.per_axis(face, barycentric, self.distances.weights)
        return pattern.blocks(face, barycentric, self.distances.metric(self.face_normals))

    def quadratic(self) -> Quadratic:
        """Gradient of the distance itself; curvature with the closest points held fixed."""
        pulls = self.distances.weights[:, None] * self.distances.offsets
        pattern = self.term.surface.pattern
        gradient = pattern.gradient(self.closest.faces, self.closest.barycentric, pulls)
        field = self.term.field
        return Quadratic({field: gradient}, {(field, field): self._curvature})
