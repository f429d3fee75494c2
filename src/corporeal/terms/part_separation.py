"""Parts of a surface pushed out of one another: no finger passes through another."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from corporeal.geometry.self_intersection import PartPenetration, PartSurfaces
from corporeal.solve.problem import Fields, Quadratic
from corporeal.terms.mesh_pattern import MeshPattern


@dataclass(frozen=True, eq=False)
class PartSeparation:
    """Squared depths of vertices inside another part; both sides are pushed.

    Attributes:
        name: of the term.
        field: the field (V, 3) of the surface's vertices, metres.
        faces: (F, 3).
        parts: the surface taken apart.
        pattern: sparsity of the mesh.
        sigma: standard deviation of a depth, metres.
    """

    name: str
    field: str
    faces: Int[np.ndarray, "F 3"]
    parts: PartSurfaces
    pattern: MeshPattern
    sigma: float

    def at(self, fields: Fields) -> PartSeparationValue:
        """Find the vertices inside other parts."""
        vertices = fields[self.field]
        found = self.parts.penetration(vertices)
        corners = self.faces[found.faces]
        closest = np.einsum("nk,nka->na", found.barycentric, vertices[corners])
        return PartSeparationValue(self, found, vertices[found.vertices] - closest)


@dataclass(frozen=True, eq=False)
class PartSeparationValue:
    """The term at one surface; offsets (N, 3), metres, from the surface passed through to the vertex."""

    term: PartSeparation
    found: PartPenetration
    offsets: Float[np.ndarray, "N 3"]

    @property
    def cost(self) -> float:
        """Half the sum of squared depths, in units of sigma squared."""
        return 0.5 * float(np.sum(self.offsets**2)) / self.term.sigma**2

    def quadratic(self) -> Quadratic:
        """Exact gradient; as curvature a diagonal that is never less than the true one.

        A vertex and the face that it passes through share no edge: their coupling would change the sparsity
        of the free vertices' system with every contact. For a residual with weights 1 and -b the diagonal
        2 (1, b) bounds it from above, at the price of shorter steps.
        """
        term, found = self.term, self.found
        pull = self.offsets / term.sigma**2
        gradient = -term.pattern.gradient(found.faces, found.barycentric, pull)
        np.add.at(gradient, found.vertices, pull)
        diagonal = np.zeros(term.pattern.vertex_count)
        np.add.at(diagonal, found.vertices, 2 / term.sigma**2)
        np.add.at(diagonal, term.faces[found.faces].ravel(), 2 / term.sigma**2 * found.barycentric.ravel())
        curvature = term.pattern.diagonal(diagonal)
        return Quadratic({term.field: gradient}, {(term.field, term.field): curvature})
