"""Parameters held to an affine subspace: a problem with fewer unknowns, its terms unchanged."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

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

    def narrowed(self, slopes: Float[np.ndarray, "m Q"]) -> Float[np.ndarray, "m n"]:
        """slopes @ directions, slopes by the parameters -> slopes by the coordinates.

        A parameter that is a coordinate by itself is copied, not multiplied: of a body all but its fingers.
        """
        alone, parameters, mixed, involved = self._structure
        narrow = np.empty((len(slopes), self.directions.shape[1]))
        narrow[:, alone] = slopes[:, parameters]
        narrow[:, mixed] = slopes[:, involved] @ self.directions[np.ix_(involved, mixed)]
        return narrow

    @cached_property
    def _structure(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Coordinates that are one parameter, and which; the others, and the parameters that they move."""
        moved = self.directions != 0
        alone = (moved.sum(axis=0) == 1) & (self.directions.max(axis=0) == 1)
        parameters = moved.argmax(axis=0)[alone]
        involved = np.flatnonzero(moved[:, ~alone].any(axis=1))
        return np.flatnonzero(alone), parameters, np.flatnonzero(~alone), involved

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
        whole = Evaluation(self._lifted(evaluation.state), evaluation.values)
        system = self.problem.normal_system(whole, self.subspace.narrowed)
        if not isinstance(system, DenseSystem):
            raise TypeError("problem: expected a dense system")
        return system

    def _lifted(self, state: State) -> State:
        return State(self.subspace.lifted(state.parameters))
