"""Coupling of free vertices to the model by edges: the term E_c of Romero et al. 2017, equation 7."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int

from corporeal.solve.curvature import PerAxisCurvature
from corporeal.solve.problem import Fields, Quadratic


def edge_laplacian(
    edges: Int[np.ndarray, "E 2"], weights: Float[np.ndarray, " E"], vertex_count: int
) -> sp.csr_matrix:
    """D^T diag(weights) D of the map D from vertices to edge vectors."""
    rows = np.repeat(np.arange(len(edges)), 2)
    signs = np.tile([1.0, -1.0], len(edges))
    D = sp.csr_matrix((signs, (rows, edges.ravel())), shape=(len(edges), vertex_count))
    return (D.T @ sp.diags(weights) @ D).tocsr()


class EdgeCoupling:
    """Squared differences between the edges (and, weakly, the places) of two fields, in units of sigma."""

    def __init__(
        self,
        name: str,
        fields: tuple[str, str],
        edges: Int[np.ndarray, "E 2"],
        vertex_count: int,
        *,
        sigma: float,
        position_sigma: float = np.inf,
        weights: Float[np.ndarray, " E"] | None = None,
    ) -> None:
        """Couple ``fields`` = (free, model), both (V, 3) in metres.

        Args:
            name: of the term.
            fields: names of the free and of the model's field.
            edges: pairs of vertices.
            vertex_count: V.
            sigma: standard deviation of an edge's difference in metres.
            position_sigma: standard deviation of a vertex's distance from the model's in metres. Edges alone
                do not see the model drift away as a whole, which leaves its translation undetermined.
            weights: base weight per edge; ones if None.
        """
        self.name = name
        self._free, self._model = fields
        base = np.ones(len(edges)) if weights is None else weights
        laplacian = edge_laplacian(edges, base / sigma**2, vertex_count)
        self._curvature = (laplacian + sp.identity(vertex_count) / position_sigma**2).tocsr()

    def at(self, fields: Fields) -> EdgeCouplingValue:
        """Evaluate."""
        difference = fields[self._free] - fields[self._model]
        slope = PerAxisCurvature(self._curvature).times(difference.reshape(-1, 1)).reshape(-1, 3)
        return EdgeCouplingValue(
            0.5 * float(np.sum(difference * slope)), slope, self._curvature, (self._free, self._model)
        )


@dataclass(frozen=True, eq=False)
class EdgeCouplingValue:
    """The term at one pair of surfaces."""

    cost: float
    slope: Float[np.ndarray, "V 3"]
    curvature: sp.csr_matrix
    names: tuple[str, str]

    def quadratic(self) -> Quadratic:
        """Exact: the term is quadratic."""
        free, model = self.names
        own = PerAxisCurvature(self.curvature)
        return Quadratic(
            {free: self.slope, model: -self.slope},
            {(free, free): own, (model, model): own, (free, model): PerAxisCurvature(-self.curvature)},
        )
