"""A surface in tetrahedra: how it follows them, and how they follow it to other people."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int

from corporeal.scans.simulation.tetrahedra import laplacian, places, vertex_gradients
from corporeal.solve.sparse import factorised

# How closely the tetrahedra follow the skin of another person, against how smoothly they are carried.
_FAITH = 3.0


class EmbeddedSkin:
    """The skin of a base person in their tetrahedra.

    Attributes:
        surface: (N, 3) skin of the base person at rest, metres.
        tet_vertices: (T, 3) metres.
        tets: (M, 4) positive volumes.
    """

    def __init__(
        self,
        surface: Float[np.ndarray, "N 3"],
        tet_vertices: Float[np.ndarray, "T 3"],
        tets: Int[np.ndarray, "M 4"],
    ) -> None:
        """Find the tetrahedron of every skin vertex and factorise what carries values inside."""
        self.surface, self.tet_vertices, self.tets = surface, tet_vertices, tets
        self._nearest, self._shares = places(surface, tet_vertices, tets)
        rows = np.repeat(np.arange(len(surface)), 4)
        entries = (self._shares.ravel(), (rows, tets[self._nearest].ravel()))
        self._onto = sp.csr_matrix(entries, shape=(len(surface), len(tet_vertices)))
        smooth = laplacian(tet_vertices, tets)
        self._scale = float(_FAITH * smooth.diagonal().mean())
        self._solver = factorised(sp.csr_matrix(self._scale * self._onto.T @ self._onto + smooth))

    def carried_over(self, values: Float[np.ndarray, "N m"]) -> Float[np.ndarray, "T m"]:
        """Values of the tetrahedra's vertices that agree with those of the surface and are smooth inside."""
        return self._solver.solve(self._scale * (self._onto.T @ values))

    def rest_of(self, surface: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "T 3"]:
        """The tetrahedra's vertices in another person's skin, metres."""
        return self.tet_vertices + self.carried_over(surface - self.surface)

    def weights(self, weights: Float[np.ndarray, "N K"]) -> Float[np.ndarray, "T K"]:
        """Skinning weights of the tetrahedra's vertices, spread smoothly from the surface."""
        spread = np.maximum(self.carried_over(weights), 0)
        return spread / spread.sum(1, keepdims=True)

    def posed(
        self,
        surface: Float[np.ndarray, "N 3"],
        rest: Float[np.ndarray, "T 3"],
        vertices: Float[np.ndarray, "T 3"],
    ) -> Float[np.ndarray, "N 3"]:
        """Skin in posed tetrahedra, metres.

        Linear interpolation alone leaves the facets of the tetrahedra in the skin; half the step from each
        corner with the corner's own mean gradient makes it exact for quadratic motions.

        Args:
            surface: the person's skin at rest.
            rest: the person's tetrahedra at rest. What they do not follow of the skin stays on it as an
                offset of the rest shape.
            vertices: the tetrahedra posed.
        """
        shares, corners = self._shares, self.tets[self._nearest]
        gradients = vertex_gradients(rest, vertices, self.tets)
        steps = np.einsum("ncab,ncb->nca", gradients[corners], surface[:, None] - rest[corners])
        left_over = surface - np.einsum("nc,nca->na", shares, rest[corners])
        mean = np.einsum("nc,ncab->nab", shares, gradients[corners])
        linear = np.einsum("nc,nca->na", shares, vertices[corners])
        linear += np.einsum("nab,nb->na", mean, left_over)
        return 0.5 * (linear + np.einsum("nc,nca->na", shares, vertices[corners] + steps))
