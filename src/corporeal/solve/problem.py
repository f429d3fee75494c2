"""The contract between squared terms and solvers.

A problem has a short dense vector of parameters and, if need be, a long *free field* of points whose
curvature is sparse. Fields that follow from the parameters (posed vertices, joints) are *derived*: terms
speak about fields, and the problem pulls their quadratics back to the parameters once, after all terms have
been added up. The cost of a step thus does not grow with (residuals x parameters).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from corporeal.solve.curvature import Curvature, PerAxisCurvature
from corporeal.solve.grouped_slopes import GroupedSlopes
from corporeal.solve.systems import ArrowSystem, DenseSystem, NormalSystem

Fields = Mapping[str, np.ndarray]
Slopes = Mapping[str, np.ndarray | GroupedSlopes]
PARAMETERS = "parameters"


@dataclass(frozen=True, eq=False)
class Quadratic:
    """Second-order model of one term: cost + gradient . d + d . curvature . d / 2, per field.

    Attributes:
        gradient: field name -> array of the field's shape.
        curvature: pair of field names -> Gauss-Newton curvature between them; a pair of different names
            stands once and its transpose is understood.
    """

    gradient: Mapping[str, np.ndarray]
    curvature: Mapping[tuple[str, str], Curvature]


@runtime_checkable
class TermValue(Protocol):
    """A term at one point; what the cost needed (closest points, say) is kept for the quadratic."""

    @property
    def cost(self) -> float:
        """Half the weighted squared residuals."""
        ...

    def quadratic(self) -> Quadratic:
        """The local quadratic."""
        ...


@runtime_checkable
class Term(Protocol):
    """A squared term. Its weight is 1 / sigma^2 with a sigma that has a unit."""

    @property
    def name(self) -> str:
        """Unique within a problem."""
        ...

    def at(self, fields: Fields) -> TermValue:
        """Evaluate at the given fields; metres, radians and unit-variance coefficients."""
        ...


@dataclass(frozen=True, eq=False)
class State:
    """A point of the search space: parameters (Q,) and the free field (n, 3), or None."""

    parameters: Float[np.ndarray, " Q"]
    free: Float[np.ndarray, "n 3"] | None = None


@dataclass(frozen=True, eq=False)
class Evaluation:
    """All terms at one state, with the cost split by term."""

    state: State
    values: Mapping[str, TermValue]

    @property
    def cost(self) -> float:
        """Sum of the terms' costs."""
        return float(sum(value.cost for value in self.values.values()))

    @property
    def costs(self) -> dict[str, float]:
        """Cost by term."""
        return {name: float(value.cost) for name, value in self.values.items()}


@dataclass(frozen=True, eq=False)
class Problem:
    """Terms over parameters, derived fields and at most one free field.

    Attributes:
        terms: the squared terms; names must differ.
        derive: parameters (Q,) -> values of the derived fields, each (n, 3).
        differentiate: parameters (Q,) -> Jacobians of the derived fields, each (n, 3, Q), by groups or whole.
        free_field: name of the free field, or None.
    """

    terms: Sequence[Term]
    derive: Callable[[np.ndarray], Fields] = field(default=lambda _: {})
    differentiate: Callable[[np.ndarray], Slopes] = field(default=lambda _: {})
    free_field: str | None = None

    def __post_init__(self) -> None:
        names = [term.name for term in self.terms]
        if len(set(names)) != len(names):
            raise ValueError(f"terms: names must differ, got {names}")

    def fields(self, state: State) -> Fields:
        """Parameters, derived fields and the free field by name."""
        fields = {PARAMETERS: state.parameters, **self.derive(state.parameters)}
        if self.free_field is not None:
            if state.free is None:
                raise ValueError(f"state: the free field {self.free_field!r} has no value")
            fields[self.free_field] = state.free
        return fields

    def evaluate(self, state: State) -> Evaluation:
        """Cost of every term at a state."""
        fields = self.fields(state)
        return Evaluation(state, {term.name: term.at(fields) for term in self.terms})

    def normal_system(
        self, evaluation: Evaluation, narrowed: Callable[[np.ndarray], np.ndarray] | None = None
    ) -> NormalSystem:
        """Gauss-Newton system of all terms, derived fields pulled back to the parameters.

        Args:
            evaluation: of this problem.
            narrowed: rows (n, Q) of slopes by the parameters -> rows of slopes by fewer unknowns, on which
                the parameters depend linearly; None where the parameters are the unknowns. Jacobians are
                narrowed before anything is multiplied by them: nearly all of a step's time goes there.
        """
        state = evaluation.state
        gradient, curvature = _sum_quadratics([value.quadratic() for value in evaluation.values.values()])
        size = state.parameters.size
        jacobians = {
            name: slopes if isinstance(slopes, GroupedSlopes) else GroupedSlopes.of_whole(slopes)
            for name, slopes in self.differentiate(state.parameters).items()
        }
        unit = np.eye(size)
        if narrowed is not None:
            jacobians = {name: slopes.narrowed(narrowed) for name, slopes in jacobians.items()}
            unit = narrowed(unit)
            size = unit.shape[1]
        H, g = np.zeros((size, size)), np.zeros(size)
        cross: np.ndarray | None = None
        for name, slope in gradient.items():
            if name in jacobians:
                g += jacobians[name].pulled_gradient(slope)
            elif name == PARAMETERS:
                g += slope @ unit
        for (a, b), block in curvature.items():
            if self.free_field in (a, b):
                if a == b:
                    continue
                other = jacobians[b if a == self.free_field else a].dense()
                part = block.times(other) if a == self.free_field else block.transposed_times(other)
                cross = part if cross is None else cross + part
            elif a == b and a in jacobians:
                H += jacobians[a].pulled_curvature(block)
            else:
                left, right = (jacobians[name].dense() if name in jacobians else unit for name in (a, b))
                product = left.T @ block.times(right)
                H += product if a == b else product + product.T
        if self.free_field is None:
            return DenseSystem(H, g)
        sparse = curvature[self.free_field, self.free_field]
        if not isinstance(sparse, PerAxisCurvature):
            raise TypeError("free field: its own curvature must be the same for x, y and z")
        free_gradient = gradient[self.free_field]
        if cross is None:
            cross = np.zeros((free_gradient.size, size))
        return ArrowSystem(sparse.matrix, cross, H, free_gradient, g)


def _sum_quadratics(
    quadratics: Sequence[Quadratic],
) -> tuple[dict[str, np.ndarray], dict[tuple[str, str], Curvature]]:
    gradient: dict[str, np.ndarray] = {}
    curvature: dict[tuple[str, str], Curvature] = {}
    for quadratic in quadratics:
        for name, slope in quadratic.gradient.items():
            gradient[name] = gradient[name] + slope if name in gradient else slope
        for pair, block in quadratic.curvature.items():
            curvature[pair] = curvature[pair].plus(block) if pair in curvature else block
    return gradient, curvature
