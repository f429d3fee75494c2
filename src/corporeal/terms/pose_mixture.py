"""Mixture prior over hand poses in its max form: equations 17-19 of Romero et al. 2017.

A single Gaussian traps a hand at the mean pose; of a mixture only the nearest component pulls.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from corporeal.solve.problem import PARAMETERS, Fields
from corporeal.terms.gaussian_prior import ParameterQuadratic


class MixturePrior:
    """min over components of -log(g_j N(pose; mean_j, covariance_j)), log-determinants kept."""

    def __init__(
        self,
        name: str,
        columns: slice,
        weights: Float[np.ndarray, " M"],
        means: Float[np.ndarray, "M D"],
        covariances: Float[np.ndarray, "M D D"],
        *,
        sigma_scale: float = 1.0,
        weight: float = 1.0,
    ) -> None:
        """Prior on ``parameters[columns]``, axis-angle in radians.

        Args:
            name: of the term.
            columns: the D pose parameters.
            weights: mixture weights, positive.
            means: component means.
            covariances: component covariances, positive definite.
            sigma_scale: every standard deviation is multiplied by it: above 1 is a weaker prior.
            weight: of the whole term, log-determinants included.
        """
        self.name = name
        self._columns = columns
        self._means = means
        self._precisions = weight * np.linalg.inv(covariances) / sigma_scale**2
        _, log_determinants = np.linalg.slogdet(covariances)
        constants = weight * (0.5 * log_determinants - np.log(weights))
        # Only differences between components matter; a cost that is never negative keeps the solver's
        # relative tolerance meaningful.
        self._constants = constants - constants.min()

    def at(self, fields: Fields) -> ParameterQuadratic:
        """Evaluate with the component that costs least."""
        parameters = fields[PARAMETERS]
        differences = parameters[self._columns] - self._means
        slopes = np.einsum("mij,mj->mi", self._precisions, differences)
        costs = 0.5 * np.einsum("mi,mi->m", differences, slopes) + self._constants
        best = int(costs.argmin())
        return ParameterQuadratic(
            float(costs[best]), self._columns, slopes[best], self._precisions[best], parameters.size
        )
