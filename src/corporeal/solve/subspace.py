"""Parameters held to an affine subspace: a problem with fewer unknowns, its terms unchanged."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from corporeal.solve.problem import Evaluation, Problem, State
from corporeal.solve.systems import DenseSystem


@dataclass(frozen=True, eq=False)
class AffineSubspace:
    """All parameter vectors origin + directions @ coordinates.

    Attributes:
        origin: (Q,) the parameters where all coordinates are zero.
        directions: (Q, n), linearly independent columns.
    """

    origin: Float[np.ndarray, " Q"]
    directions: Float[np.ndarray, "Q n"]

    def lifted(self, coordinates: Float[np.ndarray, " n"]) -> Float[np.ndarray, " Q"]:
        """The parameters at some coordinates."""
        return self.origin + self.directions @ coordinates

    def nearest(self, parameters: Float[np.ndarray, " Q"]) -> Float[np.ndarray, " n"]:
        """Coordinates of the least-squares projection."""
        return np.linalg.lstsq(self.directions, parameters - self.origin, rcond=None)[0]


@dataclass(frozen=True, eq=False)
class RestrictedProblem:
    """A problem over the coordinates of a subspace; no free field.

    Terms see the whole parameters, so that a prior costs the same in every subspace. Their gradient and
    curvature are pulled back by the chain rule.
    """

    problem: Problem
    subspace: AffineSubspace

    def __post_init__(self) -> None:
        if self.problem.free_field is not None:
            raise ValueError(f"problem: has the free field {self.problem.free_field!r}, expected none")

    def evaluate(self, state: State) -> Evaluation:
        """Cost of every term at coordinates."""
        return Evaluation(state, self.problem.evaluate(self._lifted(state)).values)

    def normal_system(self, evaluation: Evaluation) -> DenseSystem:
        """Gauss-Newton system over the coordinates."""
        whole = self.problem.normal_system(Evaluation(self._lifted(evaluation.state), evaluation.values))
        if not isinstance(whole, DenseSystem):
            raise TypeError("problem: expected a dense system")
        directions = self.subspace.directions
        return DenseSystem(directions.T @ whole.H @ directions, directions.T @ whole.gradient)

    def _lifted(self, state: State) -> State:
        return State(self.subspace.lifted(state.parameters))
