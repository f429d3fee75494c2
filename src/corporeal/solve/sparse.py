"""Symmetric positive-definite sparse systems behind one function, so that the library can be exchanged.

Why not scipy's ``splu`` alone: with the 246 right-hand sides of one registration step its solve was the
largest part of a whole registration (27 ms a step, and up to 900 ms where OpenBLAS's and numba's threads
fought over the cores); this one takes 8 ms. The fill-reducing order still comes from SuperLU.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spl
from jaxtyping import Float

from corporeal.solve import sparse_kernels as kernels

_COLUMN_CHUNK = 32


@dataclass(frozen=True, eq=False)
class _Pattern:
    """What depends on the sparsity only: order, upper triangle, elimination tree, places of the factor."""

    order: np.ndarray
    entry: np.ndarray
    starts: np.ndarray
    rows: np.ndarray
    parent: np.ndarray
    factor_starts: np.ndarray


class Factorisation:
    """Cholesky factor of a symmetric positive-definite matrix."""

    def __init__(self, matrix: sp.csr_matrix) -> None:
        matrix = sp.csr_matrix(matrix, copy=True)
        matrix.sum_duplicates()
        indptr, indices = matrix.indptr.astype(np.int32), matrix.indices.astype(np.int32)
        pattern = _pattern(matrix.shape[0], indptr.tobytes(), indices.tobytes())
        values = matrix.data[pattern.entry]
        rows, factor, smallest = kernels.factorise(
            pattern.starts, pattern.rows, values, pattern.parent, pattern.factor_starts
        )
        if not smallest > 0:
            raise ArithmeticError(
                "sparse curvature is not positive definite: a free point has no data, no edges"
            )
        self._pattern, self._rows, self._factor = pattern, rows, factor

    def solve(self, right: Float[np.ndarray, "n m"]) -> Float[np.ndarray, "n m"]:
        """Solve for all columns of a right-hand side."""
        order = self._pattern.order
        permuted = np.ascontiguousarray(right[order])
        chunks = -(-right.shape[1] // _COLUMN_CHUNK)
        kernels.solve_in_place(self._pattern.factor_starts, self._rows, self._factor, permuted, chunks)
        solution = np.empty_like(permuted)
        solution[order] = permuted
        return solution


def factorised(matrix: sp.csr_matrix) -> Factorisation:
    """Factorise once, solve often; ``ArithmeticError`` where the matrix is not positive definite."""
    return Factorisation(matrix)


@lru_cache(maxsize=8)
def _pattern(size: int, indptr: bytes, indices: bytes) -> _Pattern:
    """Analysis of one sparsity; the same topology is factorised many times."""
    starts = np.frombuffer(indptr, dtype=np.int32)
    columns = np.frombuffer(indices, dtype=np.int32)
    lower = np.repeat(np.arange(size), np.diff(starts))
    order = _fill_reducing_order(size, lower, columns)
    place = np.empty(size, dtype=np.int64)
    place[order] = np.arange(size)
    # Entries of the upper triangle of the permuted matrix, column by column.
    row, column = place[lower], place[columns]
    upper = np.flatnonzero(row <= column)
    entry = upper[np.lexsort((row[upper], column[upper]))]
    column_starts = np.searchsorted(column[entry], np.arange(size + 1))
    parent, factor_starts = kernels.elimination_tree(column_starts, row[entry])
    return _Pattern(order, entry, column_starts, row[entry], parent, factor_starts)


def _fill_reducing_order(size: int, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Minimum degree on A + A^T, asked of SuperLU with a matrix that is surely positive definite."""
    weight = np.where(rows == columns, 0.0, -1.0)
    matrix = sp.csc_matrix((weight, (rows, columns)), shape=(size, size))
    matrix = matrix + sp.diags(1.0 - np.asarray(matrix.sum(axis=1)).ravel())
    factor = spl.splu(
        matrix.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
    )
    return np.argsort(factor.perm_c)
