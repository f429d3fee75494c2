"""The normal system of terms over parameters, a derived field and a free field, against dense differences."""

import numpy as np
import pytest

from corporeal.solve.problem import Problem, State
from corporeal.solve.systems import ArrowSystem
from corporeal.terms.coupling import EdgeCoupling
from corporeal.terms.gaussian_prior import GaussianPrior
from corporeal.terms.landmarks import LandmarkDistances

POINTS, PARAMETERS = 7, 4
EDGES = np.array([[0, 1], [1, 2], [2, 3], [3, 4], [4, 5], [5, 6], [0, 6], [1, 4]])


def make_problem(rng, *, free: bool):
    """A field that follows linearly from four parameters, coupled to free points; residuals are linear."""
    base = rng.standard_normal((POINTS, 3))
    jacobian = rng.standard_normal((POINTS, 3, PARAMETERS))
    factor = rng.standard_normal((PARAMETERS, PARAMETERS))
    terms = [
        GaussianPrior("prior", slice(0, PARAMETERS), rng.standard_normal(PARAMETERS), factor @ factor.T),
        LandmarkDistances(
            "marks", "model", rng.standard_normal((POINTS, 3)), np.full(POINTS, 0.5), robust_scale=1e9
        ),
    ]
    if free:
        terms.append(
            EdgeCoupling("coupling", ("free", "model"), EDGES, POINTS, sigma=0.3, position_sigma=2.0)
        )
        terms.append(
            LandmarkDistances(
                "data", "free", rng.standard_normal((POINTS, 3)), np.full(POINTS, 0.7), robust_scale=1e9
            )
        )
    return Problem(
        terms,
        derive=lambda vector: {"model": base + jacobian @ vector},
        differentiate=lambda _: {"model": jacobian},
        free_field="free" if free else None,
    )


def differences(function, at, step=1e-3):
    """Central differences, exact but for rounding where the function is quadratic."""
    gradient = np.zeros(at.size)
    hessian = np.zeros((at.size, at.size))
    unit = step * np.eye(at.size)
    for i in range(at.size):
        gradient[i] = (function(at + unit[i]) - function(at - unit[i])) / (2 * step)
        for j in range(i, at.size):
            mixed = (
                function(at + unit[i] + unit[j]) - function(at + unit[i] - unit[j])
                - function(at - unit[i] + unit[j]) + function(at - unit[i] - unit[j])
            )  # fmt: skip
            hessian[i, j] = hessian[j, i] = mixed / (4 * step**2)
    return gradient, hessian


@pytest.mark.parametrize("free", [False, True])
def test_gradient_curvature_and_step_are_those_of_dense_differences(rng, free):
    problem = make_problem(rng, free=free)

    def state(vector):
        rest = vector[PARAMETERS:].reshape(POINTS, 3) if free else None
        return State(vector[:PARAMETERS], rest)

    at = rng.standard_normal(PARAMETERS + (3 * POINTS if free else 0))
    system = problem.normal_system(problem.evaluate(state(at)))
    assert isinstance(system, ArrowSystem) == free
    gradient, hessian = differences(lambda vector: problem.evaluate(state(vector)).cost, at)
    scale = np.abs(hessian).max()
    np.testing.assert_allclose(system.gradient, gradient, atol=1e-6 * scale)
    np.testing.assert_allclose(system.diagonal(), np.diag(hessian), atol=1e-6 * scale)
    for _ in range(5):
        along = rng.standard_normal(at.size)
        assert system.curvature_along(along) == pytest.approx(along @ hessian @ along, rel=1e-6)
    # All residuals are linear: one step must end where the gradient is zero.
    end = at + system.newton_step()
    last = problem.normal_system(problem.evaluate(state(end)))
    assert np.abs(last.gradient).max() < 1e-9 * np.abs(gradient).max()


def test_a_free_field_without_a_value_is_named(rng):
    problem = make_problem(rng, free=True)
    with pytest.raises(ValueError, match="'free' has no value"):
        problem.evaluate(State(np.zeros(PARAMETERS)))


def test_terms_of_one_name_are_refused():
    term = GaussianPrior.isotropic("prior", slice(0, 2), np.zeros(2), 1.0)
    with pytest.raises(ValueError, match="names must differ"):
        Problem([term, term])
