"""Symmetric positive-definite sparse systems behind one function, so that the library can be exchanged."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spl
from jaxtyping import Float


class Factorisation:
    """A factorised symmetric positive-definite matrix."""

    def __init__(self, matrix: sp.csr_matrix) -> None:
        try:
            # Minimum degree on A + A^T with diagonal pivots: the matrix is symmetric and needs no pivoting.
            self._lu = spl.splu(
                matrix.tocsc(),
                permc_spec="MMD_AT_PLUS_A",
                diag_pivot_thresh=0.0,
                options={"SymmetricMode": True},
            )
        except RuntimeError as error:
            raise ArithmeticError(
                "sparse curvature is singular: a free point has neither data nor edges"
            ) from error

    def solve(self, right: Float[np.ndarray, "n m"]) -> Float[np.ndarray, "n m"]:
        """Solve for all columns of a right-hand side."""
        return self._lu.solve(right)


def factorised(matrix: sp.csr_matrix) -> Factorisation:
    """Factorise once, solve often; ``ArithmeticError`` where the matrix is singular."""
    return Factorisation(matrix)
