"""Landmarks of the model to measured points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float

from corporeal.solve.curvature import PerAxisCurvature
from corporeal.solve.problem import Fields, Quadratic
from corporeal.terms.robust import geman_mcclure


@dataclass(frozen=True, eq=False)
class LandmarkDistances:
    """Squared robust distances between a field of landmarks and measured points.

    Attributes:
        name: of the term.
        field: the field (N, 3) of landmarks, metres.
        targets: (N, 3) measured points, metres.
        sigmas: (N,) standard deviation of each in metres; infinite leaves a landmark out.
        robust_scale: Geman-McClure scale in units of sigma.
    """

    name: str
    field: str
    targets: Float[np.ndarray, "N 3"]
    sigmas: Float[np.ndarray, " N"]
    robust_scale: float = np.inf

    def at(self, fields: Fields) -> LandmarkValue:
        """Evaluate."""
        offsets = fields[self.field] - self.targets
        precision = 1 / self.sigmas**2
        squared = precision * np.einsum("na,na->n", offsets, offsets)
        value, slope = geman_mcclure(squared, self.robust_scale)
        return LandmarkValue(0.5 * float(value.sum()), self.field, offsets, precision * slope)


@dataclass(frozen=True, eq=False)
class LandmarkValue:
    """The term at one state."""

    cost: float
    field: str
    offsets: Float[np.ndarray, "N 3"]
    weights: Float[np.ndarray, " N"]

    def quadratic(self) -> Quadratic:
        """Iteratively reweighted least squares."""
        gradient = self.weights[:, None] * self.offsets
        curvature = PerAxisCurvature(sp.diags(self.weights).tocsr())
        return Quadratic({self.field: gradient}, {(self.field, self.field): curvature})
