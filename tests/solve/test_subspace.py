"""A problem on a subspace against the same problem with the terms written in its coordinates."""

import numpy as np
import pytest

from corporeal.solve.curvature import DenseCurvature
from corporeal.solve.dogleg import DoglegOptions, Outcome, solve, solve_within
from corporeal.solve.problem import PARAMETERS, Problem, Quadratic, State
from corporeal.solve.subspace import AffineSubspace, RestrictedProblem


class _Value:
    def __init__(self, r, J):
        self.cost, self._r, self._J = 0.5 * float(r @ r), r, J

    def quadratic(self):
        J, r = self._J, self._r
        return Quadratic({PARAMETERS: J.T @ r}, {(PARAMETERS, PARAMETERS): DenseCurvature(J.T @ J)})


class _Curved:
    """Residuals A x + sin(x)."""

    name = "curved"

    def __init__(self, A):
        self._A = A

    def at(self, fields):
        x = fields[PARAMETERS]
        return _Value(self._A @ x + np.sin(x) - 1, self._A + np.diag(np.cos(x)))


@pytest.fixture
def restricted(rng):
    problem = Problem([_Curved(rng.normal(size=(6, 6)) + 3 * np.eye(6))])
    return RestrictedProblem(problem, AffineSubspace(rng.normal(size=6), rng.normal(size=(6, 3))))


def test_gradient_is_the_slope_of_the_cost_along_coordinates(restricted, rng):
    z = rng.normal(size=3)
    system = restricted.normal_system(restricted.evaluate(State(z)))
    for _ in range(4):
        along = rng.normal(size=3)
        up, down = (restricted.evaluate(State(z + sign * 1e-6 * along)).cost for sign in (1, -1))
        assert (up - down) / 2e-6 == pytest.approx(system.gradient @ along, rel=1e-6)


def test_curvature_is_that_of_the_terms_in_coordinates(restricted, rng):
    z, B = rng.normal(size=3), restricted.subspace.directions
    x = restricted.subspace.lifted(z)
    J = restricted.problem.terms[0].at({PARAMETERS: x})._J @ B
    system = restricted.normal_system(restricted.evaluate(State(z)))
    assert np.allclose(system.H, J.T @ J, rtol=1e-12)


def test_the_solution_lies_in_the_subspace_and_is_stationary_there(restricted, rng):
    options = DoglegOptions(iterations=100, relative_decrease=1e-14)
    start = State(rng.normal(size=6))
    found = solve_within(restricted.problem, restricted.subspace, start, options)
    x = found.state.parameters
    assert found.outcome is Outcome.CONVERGED
    assert np.abs(restricted.subspace.lifted(restricted.subspace.nearest(x)) - x).max() < 1e-12
    whole = restricted.problem.normal_system(restricted.problem.evaluate(State(x)))
    along = restricted.subspace.directions.T @ whole.gradient
    assert np.abs(along).max() < 1e-4 * np.abs(whole.gradient).max()
    assert found.cost > solve(restricted.problem, start, options).cost


def test_narrowed_slopes_are_those_of_the_product(rng):
    directions = np.zeros((9, 6))
    directions[[4, 0, 7], [0, 2, 3]] = 1
    directions[[1, 2, 3], 1] = 1, -2, 0.5
    directions[[2, 3, 8], 4] = rng.normal(size=3)
    directions[6, 5] = 2
    slopes = rng.normal(size=(5, 9))
    narrowed = AffineSubspace(np.zeros(9), directions).narrowed(slopes)
    assert np.allclose(narrowed, slopes @ directions, rtol=1e-14, atol=1e-14)


def test_nearest_is_the_least_squares_projection(restricted, rng):
    subspace, x = restricted.subspace, rng.normal(size=6)
    left = x - subspace.lifted(subspace.nearest(x))
    assert np.abs(subspace.directions.T @ left).max() < 1e-12


def test_a_free_field_is_refused(rng):
    with pytest.raises(ValueError, match="free field"):
        RestrictedProblem(Problem([], free_field="free"), AffineSubspace(np.zeros(2), np.eye(2)))
