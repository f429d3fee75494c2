"""Curvature blocks of the normal equations: dense, the same for x, y, z, or 3 x 3 blocks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int

from corporeal.solve.curvature_kernels import rows_of_blocks, rows_per_axis


@runtime_checkable
class Curvature(Protocol):
    """A linear map between two fields, applied to the rows of a Jacobian."""

    def times(self, columns: np.ndarray) -> np.ndarray:
        """The map applied to a matrix of columns."""
        ...

    def transposed_times(self, columns: np.ndarray) -> np.ndarray:
        """The transposed map applied to a matrix of columns."""
        ...

    def plus(self, other: Curvature) -> Curvature:
        """Sum of two maps of the same kind."""
        ...

    def dense(self) -> np.ndarray:
        """As a full matrix."""
        ...


@runtime_checkable
class SparseCurvature(Protocol):
    """A curvature that couples a point to few others, so that some of its rows can be had alone."""

    def rows_times(
        self, points: Int[np.ndarray, " r"], place: Int[np.ndarray, " n"], slopes: Float[np.ndarray, "m 3 a"]
    ) -> Float[np.ndarray, "r3 a"]:
        """The rows of ``points`` applied to slopes; those of point j stand at ``place[j]``, -1 for nowhere.

        Raises:
            ValueError: the slopes of a point that these are coupled to stand nowhere.
        """
        ...


@dataclass(frozen=True, eq=False)
class DenseCurvature:
    """A full matrix (n, m)."""

    matrix: Float[np.ndarray, "n m"]

    def times(self, columns: np.ndarray) -> np.ndarray:
        """matrix @ columns."""
        return self.matrix @ columns

    def transposed_times(self, columns: np.ndarray) -> np.ndarray:
        """matrix.T @ columns."""
        return self.matrix.T @ columns

    def plus(self, other: Curvature) -> DenseCurvature:
        """Sum with any other kind."""
        return DenseCurvature(self.matrix + other.dense())

    def dense(self) -> np.ndarray:
        """The matrix itself."""
        return self.matrix


@dataclass(frozen=True, eq=False)
class PerAxisCurvature:
    """A sparse (n, m) matrix that acts alike on x, y and z: its Kronecker product with the 3 x 3 identity."""

    matrix: sp.csr_matrix

    def times(self, columns: np.ndarray) -> np.ndarray:
        """(matrix x I3) @ columns, for columns of length 3 m."""
        return _per_axis(self.matrix, columns)

    def transposed_times(self, columns: np.ndarray) -> np.ndarray:
        """(matrix x I3).T @ columns, for columns of length 3 n."""
        return _per_axis(self.matrix.T.tocsr(), columns)

    def rows_times(
        self, points: Int[np.ndarray, " r"], place: Int[np.ndarray, " n"], slopes: Float[np.ndarray, "m 3 a"]
    ) -> Float[np.ndarray, "r3 a"]:
        """See ``SparseCurvature``."""
        matrix = self.matrix
        product, whole = rows_per_axis(matrix.indptr, matrix.indices, matrix.data, points, place, slopes)
        return _if_whole(product, whole)

    def plus(self, other: Curvature) -> Curvature:
        """Sum; with 3 x 3 blocks the result has 3 x 3 blocks."""
        if isinstance(other, PerAxisCurvature):
            return PerAxisCurvature((self.matrix + other.matrix).tocsr())
        return other.plus(self)

    def dense(self) -> np.ndarray:
        """As a full (3 n, 3 m) matrix."""
        return np.kron(self.matrix.toarray(), np.eye(3))


@dataclass(frozen=True, eq=False)
class BlockCurvature:
    """A sparse (n, n) pattern of 3 x 3 blocks: what point-to-plane distances give.

    Attributes:
        indptr: (n + 1,) row starts.
        indices: (b,) column of every block.
        blocks: (b, 3, 3).
    """

    indptr: np.ndarray
    indices: np.ndarray
    blocks: Float[np.ndarray, "b 3 3"]

    def times(self, columns: np.ndarray) -> np.ndarray:
        """Blocks @ columns, for columns of length 3 n."""
        everywhere = np.arange(len(self.indptr) - 1)
        return self.rows_times(everywhere, everywhere, _by_point(columns)).reshape(columns.shape)

    def transposed_times(self, columns: np.ndarray) -> np.ndarray:
        """The same as ``times``: the matrix is symmetric."""
        return self.times(columns)

    def rows_times(
        self, points: Int[np.ndarray, " r"], place: Int[np.ndarray, " n"], slopes: Float[np.ndarray, "m 3 a"]
    ) -> Float[np.ndarray, "r3 a"]:
        """See ``SparseCurvature``."""
        product, whole = rows_of_blocks(self.indptr, self.indices, self.blocks, points, place, slopes)
        return _if_whole(product, whole)

    def plus(self, other: Curvature) -> BlockCurvature:
        """Sum with blocks, or with a per-axis matrix."""
        mine = self._sparse()
        theirs = (
            other._sparse()
            if isinstance(other, BlockCurvature)
            else sp.kron(other.matrix, sp.identity(3)).tobsr((3, 3))  # type: ignore[attr-defined]
        )
        total = (mine + theirs).tobsr((3, 3))
        return BlockCurvature(total.indptr, total.indices, total.data)

    def dense(self) -> np.ndarray:
        """As a full (3 n, 3 n) matrix."""
        return self._sparse().toarray()

    def _sparse(self) -> sp.bsr_matrix:
        size = 3 * (len(self.indptr) - 1)
        return sp.bsr_matrix((self.blocks, self.indices, self.indptr), shape=(size, size))


def _if_whole(product: np.ndarray, whole: bool) -> np.ndarray:
    if not whole:
        raise ValueError("curvature: couples a point of a group to one whose slopes the group does not have")
    return product.reshape(-1, product.shape[2])


def _by_point(columns: np.ndarray) -> Float[np.ndarray, "m 3 a"]:
    """Columns of length 3 m as the slopes of m points."""
    return np.ascontiguousarray(columns).reshape(columns.shape[0] // 3, 3, -1)


def _per_axis(matrix: sp.csr_matrix, columns: np.ndarray) -> np.ndarray:
    rows, points = (np.arange(count) for count in matrix.shape)
    product = PerAxisCurvature(matrix).rows_times(rows, points, _by_point(columns))
    return product.reshape(3 * len(rows), *columns.shape[1:])
