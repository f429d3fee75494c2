"""Squared distances to a surface, shared by both directions (scan to mesh and mesh to scan)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from corporeal.terms.robust import geman_mcclure


@dataclass(frozen=True)
class DistanceOptions:
    """How a distance is weighted.

    Attributes:
        sigma: standard deviation of a distance in metres; the term is counted in units of it.
        robust_scale: scale of Geman-McClure in metres; infinite for the plain square.
        tangential: curvature along the surface as a share of that across it: 1 is point-to-point, which acts
            alike on x, y and z; small values let the surface slide, as point-to-plane does. Cost and gradient
            are those of the true distance whatever it is; only the step changes.
        minimum_cosine: pairs whose normals disagree more are not matched; -1 matches all.
    """

    sigma: float = 1e-3
    robust_scale: float = np.inf
    tangential: float = 1.0
    minimum_cosine: float = -1.0

    def __post_init__(self) -> None:
        if not (self.sigma > 0 and self.robust_scale > 0):
            raise ValueError("sigma, robust_scale: must be positive lengths in metres")
        if not 0 <= self.tangential <= 1:
            raise ValueError(f"tangential: must lie between 0 and 1, got {self.tangential}")


@dataclass(frozen=True, eq=False)
class WeightedDistances:
    """Offsets to the closest points with robust weights; pairs that do not match cost a constant.

    A pair without a match costs what Geman-McClure gives at infinity, not nothing: a fit must not gain by
    turning its back on the data.
    """

    cost: float
    offsets: Float[np.ndarray, "n 3"]
    weights: Float[np.ndarray, " n"]
    options: DistanceOptions

    @classmethod
    def of(
        cls, offsets: Float[np.ndarray, "n 3"], weights: Float[np.ndarray, " n"],
        matched: Bool[np.ndarray, " n"], options: DistanceOptions,
    ) -> WeightedDistances:  # fmt: skip
        """Weigh the offsets (metres) by their base weights and the robust function."""
        squared = np.einsum("na,na->n", offsets, offsets)
        value, slope = geman_mcclure(squared, options.robust_scale)
        if np.isfinite(options.robust_scale):
            value = np.where(matched, value, options.robust_scale**2)
        else:
            value = np.where(matched, value, 0.0)
        precision = 1 / options.sigma**2
        weighted = weights * precision * np.where(matched, slope, 0.0)
        return cls(0.5 * precision * float(weights @ value), offsets, weighted, options)

    @property
    def is_per_axis(self) -> bool:
        """Whether the curvature is the same for x, y and z."""
        return self.options.tangential == 1.0

    def metric(self, fallback_normals: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3 3"]:
        """Curvature per pair: weight (n n^T + tangential (I - n n^T)), n along the offset.

        The offset to an inner closest point is along the normal; where it vanishes the given normal is used.
        """
        length = np.linalg.norm(self.offsets, axis=1)
        tiny = length < 1e-9
        normal = np.where(
            tiny[:, None], fallback_normals, self.offsets / np.where(tiny, 1.0, length)[:, None]
        )
        tangential = self.options.tangential
        outer = (1 - tangential) * normal[:, :, None] * normal[:, None, :] + tangential * np.eye(3)
        return self.weights[:, None, None] * outer
