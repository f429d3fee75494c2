"""Anatomical limits of joints as a squared hinge: nothing inside, a wall outside."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from corporeal.solve.problem import PARAMETERS, Fields
from corporeal.terms.gaussian_prior import ParameterQuadratic


@dataclass(frozen=True, eq=False)
class PoseLimits:
    """Squared distance of parameters[columns] outside their limits, in units of sigma.

    Attributes:
        name: of the term.
        columns: which parameters.
        limits: (D, 2) lower and upper limit, radians.
        sigma: standard deviation of a transgression, radians.
    """

    name: str
    columns: slice
    limits: Float[np.ndarray, "D 2"]
    sigma: float

    def at(self, fields: Fields) -> ParameterQuadratic:
        """Evaluate; curvature only where a limit is crossed."""
        parameters = fields[PARAMETERS]
        pose = parameters[self.columns]
        outside = np.maximum(pose - self.limits[:, 1], 0) - np.maximum(self.limits[:, 0] - pose, 0)
        precision = 1 / self.sigma**2
        curvature = np.diag(np.where(outside != 0, precision, 0.0))
        return ParameterQuadratic(
            0.5 * precision * float(outside @ outside),
            self.columns,
            precision * outside,
            curvature,
            parameters.size,
        )
