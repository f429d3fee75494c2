"""Gaussian priors on some of the parameters: shape (equation 9) and pose (equation 8) of the MANO paper."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from corporeal.solve.curvature import DenseCurvature
from corporeal.solve.problem import PARAMETERS, Fields, Quadratic


@dataclass(frozen=True, eq=False)
class GaussianPrior:
    """Squared Mahalanobis distance of parameters[columns] from a mean.

    Attributes:
        name: of the term.
        columns: which parameters.
        mean: (D,).
        precision: (D, D) inverse covariance.
    """

    name: str
    columns: slice
    mean: Float[np.ndarray, " D"]
    precision: Float[np.ndarray, "D D"]

    @classmethod
    def isotropic(
        cls, name: str, columns: slice, mean: Float[np.ndarray, " D"], sigma: float
    ) -> GaussianPrior:
        """The same standard deviation, in the parameters' unit, for all."""
        return cls(name, columns, mean, np.eye(len(mean)) / sigma**2)

    def at(self, fields: Fields) -> ParameterQuadratic:
        """Evaluate."""
        parameters = fields[PARAMETERS]
        difference = parameters[self.columns] - self.mean
        slope = self.precision @ difference
        return ParameterQuadratic(
            0.5 * float(difference @ slope), self.columns, slope, self.precision, parameters.size
        )


@dataclass(frozen=True, eq=False)
class ParameterQuadratic:
    """Value, slope and curvature on a slice of the parameters."""

    cost: float
    columns: slice
    slope: Float[np.ndarray, " D"]
    precision: Float[np.ndarray, "D D"]
    size: int

    def quadratic(self) -> Quadratic:
        """Embedded in all parameters."""
        gradient, curvature = np.zeros(self.size), np.zeros((self.size, self.size))
        gradient[self.columns] = self.slope
        curvature[self.columns, self.columns] = self.precision
        return Quadratic({PARAMETERS: gradient}, {(PARAMETERS, PARAMETERS): DenseCurvature(curvature)})
