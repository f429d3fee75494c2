"""Powell's dogleg: a trust-region path from the Cauchy point to the Gauss-Newton step.

Nocedal and Wright 2006, chapter 4.1; the optimiser of the MANO paper (section 3.2).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from corporeal.solve.blas_threads import single_threaded_blas
from corporeal.solve.problem import Evaluation, Problem, State
from corporeal.solve.subspace import AffineSubspace, RestrictedProblem
from corporeal.solve.systems import NormalSystem, SingularSystemError


class Outcome(Enum):
    """Why a solver stopped."""

    CONVERGED = "converged: the cost no longer falls"
    STEP_LIMIT = "stopped at the iteration limit"
    NO_PROGRESS = "stopped: no step lowers the cost"
    SINGULAR = "stopped: the normal equations are singular"
    NOT_FINITE = "stopped: the cost is not a finite number"

    @property
    def usable(self) -> bool:
        """Whether the state may be used: all but singular and not finite."""
        return self not in (Outcome.SINGULAR, Outcome.NOT_FINITE)


@dataclass(frozen=True)
class DoglegOptions:
    """Limits of one solve.

    Attributes:
        iterations: most accepted or refused steps.
        relative_decrease: converged when the cost falls by less than this share.
        radius: first trust radius, in units of the curvature-scaled step (infinite starts with full steps).
    """

    iterations: int = 30
    relative_decrease: float = 1e-4
    radius: float = np.inf


@dataclass(frozen=True, eq=False)
class Solution:
    """Where a solver ended.

    Attributes:
        state: parameters and free field.
        outcome: why it stopped.
        cost: final cost; ``costs`` splits it by term.
        iterations: steps tried.
    """

    state: State
    outcome: Outcome
    cost: float
    costs: dict[str, float]
    iterations: int


def solve(
    problem: Problem | RestrictedProblem,
    start: State,
    options: DoglegOptions | None = None,
    on_step: Callable[[int, Evaluation], None] | None = None,
) -> Solution:
    """Minimise a problem from a start; never raises for bad numbers, the outcome says what happened."""
    with single_threaded_blas():
        return _solved(problem, start, options or DoglegOptions(), on_step)


def _solved(
    problem: Problem | RestrictedProblem,
    start: State,
    options: DoglegOptions,
    on_step: Callable[[int, Evaluation], None] | None,
) -> Solution:
    here = problem.evaluate(start)
    if not np.isfinite(here.cost):
        return _solution(here, Outcome.NOT_FINITE, 0)
    radius = options.radius
    system: NormalSystem | None = None
    outcome = Outcome.STEP_LIMIT
    iteration = 0
    for iteration in range(1, options.iterations + 1):
        if system is None:
            system = problem.normal_system(here)
            path = _Path(system)
        try:
            step = path.step(radius)
        except SingularSystemError:
            outcome = Outcome.SINGULAR
            break
        predicted = -(path.slope(step) + 0.5 * system.curvature_along(step))
        there = problem.evaluate(_moved(here.state, step))
        gain = (here.cost - there.cost) / predicted if predicted > 0 else -1.0
        length = path.length(step)
        if gain > 0.75:
            radius = max(radius, 3.0 * length)
        elif not gain > 0.25:
            radius = 0.35 * length
        if gain > 1e-4:
            decrease = here.cost - there.cost
            here, system = there, None
            if on_step is not None:
                on_step(iteration, here)
            if decrease < options.relative_decrease * max(here.cost, 1e-300):
                outcome = Outcome.CONVERGED
                break
        elif predicted < 1e-9 * max(here.cost, 1e-300) or radius < 1e-9:
            outcome = Outcome.CONVERGED if predicted < 1e-6 * here.cost else Outcome.NO_PROGRESS
            break
    return _solution(here, outcome, iteration)


def solve_within(
    problem: Problem, subspace: AffineSubspace, start: State, options: DoglegOptions | None = None
) -> Solution:
    """Minimise over a subspace, from the start's projection onto it; the solution holds whole parameters."""
    coordinates = State(subspace.nearest(start.parameters))
    found = solve(RestrictedProblem(problem, subspace), coordinates, options)
    return replace(found, state=State(subspace.lifted(found.state.parameters)))


class _Path:
    """The dogleg path of one system, in coordinates scaled by the square root of the curvature's diagonal."""

    def __init__(self, system: NormalSystem) -> None:
        self._system = system
        diagonal = system.diagonal()
        self._scale = np.sqrt(np.maximum(diagonal, 1e-12 * max(diagonal.max(), 1e-300)))
        self._newton: np.ndarray | None = None

    def length(self, step: np.ndarray) -> float:
        return float(np.linalg.norm(self._scale * step))

    def slope(self, step: np.ndarray) -> float:
        return float(self._system.gradient @ step)

    def step(self, radius: float) -> np.ndarray:
        if self._newton is None:
            self._newton = self._system.newton_step()
        newton = self._newton
        if self.length(newton) <= radius:
            return newton
        steepest = -self._system.gradient / self._scale**2
        along = self._system.curvature_along(steepest)
        cauchy = steepest * (-self.slope(steepest) / max(along, 1e-300))
        cauchy_length = self.length(cauchy)
        if cauchy_length >= radius:
            return cauchy * (radius / cauchy_length)
        leg = newton - cauchy
        a = self.length(leg) ** 2
        b = 2 * float((self._scale * cauchy) @ (self._scale * leg))
        c = cauchy_length**2 - radius**2
        # The stable root: b may be of either sign and c is negative.
        root = np.sqrt(b * b - 4 * a * c)
        share = (-b + root) / (2 * a) if b <= 0 else -2 * c / (b + root)
        return cauchy + share * leg


def _moved(state: State, step: np.ndarray) -> State:
    size = state.parameters.size
    free = None if state.free is None else state.free + step[size:].reshape(state.free.shape)
    return State(state.parameters + step[:size], free)


def _solution(evaluation: Evaluation, outcome: Outcome, iterations: int) -> Solution:
    return Solution(evaluation.state, outcome, evaluation.cost, evaluation.costs, iterations)
