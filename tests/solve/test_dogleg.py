"""The solver on problems whose answer is known."""

import numpy as np
import pytest
import scipy.sparse as sp

from corporeal.solve.curvature import BlockCurvature, DenseCurvature, PerAxisCurvature
from corporeal.solve.dogleg import DoglegOptions, Outcome, solve
from corporeal.solve.problem import PARAMETERS, Problem, Quadratic, State
from corporeal.solve.systems import ArrowSystem, DenseSystem, SingularSystemError


class _Value:
    def __init__(self, cost, gradient, curvature):
        self.cost, self._gradient, self._curvature = cost, gradient, curvature

    def quadratic(self):
        return Quadratic({PARAMETERS: self._gradient}, {(PARAMETERS, PARAMETERS): self._curvature})


class _LeastSquares:
    name = "least squares"

    def __init__(self, residual, jacobian):
        self._residual, self._jacobian = residual, jacobian

    def at(self, fields):
        x = fields[PARAMETERS]
        r, J = self._residual(x), self._jacobian(x)
        return _Value(0.5 * float(r @ r), J.T @ r, DenseCurvature(J.T @ J))


def _rosenbrock():
    return _LeastSquares(
        lambda x: np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]]),
        lambda x: np.array([[-20 * x[0], 10.0], [-1.0, 0.0]]),
    )


@pytest.mark.parametrize("radius", [np.inf, 1.0, 0.01])
def test_rosenbrock_is_solved_from_the_classic_start(radius):
    options = DoglegOptions(iterations=200, relative_decrease=1e-14, radius=radius)
    solution = solve(Problem([_rosenbrock()]), State(np.array([-1.2, 1.0])), options)
    assert np.abs(solution.state.parameters - 1).max() < 1e-6


def test_every_accepted_step_lowers_the_cost():
    costs = []
    solve(
        Problem([_rosenbrock()]),
        State(np.array([-1.2, 1.0])),
        DoglegOptions(iterations=100, relative_decrease=0.0, radius=0.1),
        lambda _, evaluation: costs.append(evaluation.cost),
    )
    assert len(costs) > 5 and np.all(np.diff(costs) < 0)


def test_a_cost_that_is_not_finite_is_an_outcome_not_an_exception():
    term = _LeastSquares(lambda x: x * np.nan, lambda x: np.eye(len(x)))
    assert solve(Problem([term]), State(np.ones(2))).outcome is Outcome.NOT_FINITE


def test_an_unobserved_parameter_is_named_singular():
    term = _LeastSquares(lambda x: x[:1] - 1, lambda x: np.array([[1.0, 0.0]]))
    assert solve(Problem([term]), State(np.zeros(2))).outcome is Outcome.SINGULAR


def test_terms_must_have_different_names():
    with pytest.raises(ValueError, match="names must differ"):
        Problem([_rosenbrock(), _rosenbrock()])


def _random_arrow(rng, n=7, Q=4):
    D = sp.random(n, n, 0.4, random_state=np.random.default_rng(3))
    sparse = (D.T @ D + sp.identity(n)).tocsr()
    root = rng.normal(size=(3 * n + Q, 3 * n + Q)) * 0.1
    whole = root @ root.T
    cross = whole[Q:, :Q]
    H = whole[:Q, :Q] + np.eye(Q) * 5
    return ArrowSystem(sparse, cross, H, rng.normal(size=(n, 3)), rng.normal(size=Q))


def _full(system):
    sparse = np.kron(system.sparse.toarray(), np.eye(3))
    return np.block([[system.H, system.cross.T], [system.cross, sparse]])


def test_the_arrow_is_eliminated_exactly(rng):
    system = _random_arrow(rng)
    full = _full(system)
    expected = -np.linalg.solve(full, system.gradient)
    assert np.abs(system.newton_step() - expected).max() < 1e-12
    vector = rng.normal(size=len(full))
    assert system.curvature_along(vector) == pytest.approx(vector @ full @ vector, rel=1e-12)
    assert np.allclose(system.diagonal(), np.diag(full), atol=1e-14)


def test_systems_that_are_not_positive_definite_say_so():
    with pytest.raises(SingularSystemError):
        DenseSystem(np.diag([1.0, 0.0]), np.ones(2)).newton_step()


def test_curvatures_multiply_and_add_like_their_dense_matrices(rng):
    n, width = 5, 4
    matrix = sp.random(n, n, 0.5, random_state=np.random.default_rng(1)).tocsr()
    matrix = (matrix + matrix.T).tocsr()
    per_axis = PerAxisCurvature(matrix)
    pattern = (matrix + sp.identity(n)).tocsr()
    blocks = rng.normal(size=(pattern.nnz, 3, 3))
    block = BlockCurvature(pattern.indptr, pattern.indices, blocks)
    columns = rng.normal(size=(3 * n, width))
    for curvature in (per_axis, block):
        assert np.allclose(curvature.times(columns), curvature.dense() @ columns, atol=1e-13)
    assert np.allclose(per_axis.plus(block).dense(), per_axis.dense() + block.dense(), atol=1e-13)
    assert np.allclose(block.plus(per_axis).dense(), per_axis.dense() + block.dense(), atol=1e-13)
    assert np.allclose(per_axis.transposed_times(columns), per_axis.dense().T @ columns, atol=1e-13)
