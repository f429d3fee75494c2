"""The sparse Cholesky solver against scipy."""

import numpy as np
import pytest
import scipy.sparse as sp
import scipy.sparse.linalg as spl

from corporeal.solve.sparse import factorised


def _definite(size, density, seed):
    D = sp.random(size, size, density, random_state=np.random.default_rng(seed))
    return (D.T @ D + 0.1 * sp.identity(size)).tocsr()


@pytest.mark.parametrize(("size", "density"), [(1, 1.0), (5, 0.5), (60, 0.05), (400, 0.004)])
def test_it_solves_as_scipy_does(size, density, rng):
    matrix = _definite(size, density, size)
    right = rng.normal(size=(size, 70))
    expected = spl.spsolve(matrix.tocsc(), right).reshape(size, 70)
    got = factorised(matrix).solve(right)
    assert np.abs(got - expected).max() < 1e-9 * np.abs(expected).max()


def test_one_pattern_serves_other_numbers(rng):
    matrix = _definite(50, 0.05, 1)
    other = matrix.copy()
    other.data = other.data * 2.0
    right = rng.normal(size=(50, 3))
    assert np.allclose(factorised(matrix).solve(right), 2 * factorised(other).solve(right), rtol=1e-10)


def test_a_matrix_that_is_not_definite_is_refused():
    with pytest.raises(ArithmeticError, match="positive definite"):
        factorised(sp.csr_matrix(np.array([[1.0, 2.0], [2.0, 1.0]])))
    with pytest.raises(ArithmeticError, match="positive definite"):
        factorised(sp.csr_matrix(np.array([[1.0, 0.0], [0.0, np.nan]])))


def test_duplicates_and_wide_indices_are_understood_and_left_alone(rng):
    rows, columns = [0, 0, 1, 1, 2], [0, 0, 1, 1, 2]
    matrix = sp.coo_matrix(([1.0, 2, 3, 1, 2], (rows, columns)), shape=(3, 3))
    untidy = sp.csr_matrix((matrix.data, np.array(columns), np.array([0, 2, 4, 5])), shape=(3, 3))
    untidy.indptr, untidy.indices = untidy.indptr.astype(np.int64), untidy.indices.astype(np.int64)
    right = rng.normal(size=(3, 2))
    assert np.allclose(factorised(untidy).solve(right), right / np.array([[3.0], [4], [2]]))
    assert untidy.nnz == 5
