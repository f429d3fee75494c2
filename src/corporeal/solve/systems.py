"""Normal equations that a trust-region method can step on: dense, and an arrow with a sparse head."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np
import scipy.linalg
import scipy.sparse as sp
from jaxtyping import Float

from corporeal.solve.curvature import PerAxisCurvature
from corporeal.solve.sparse import factorised


class SingularSystemError(ArithmeticError):
    """The normal equations have no unique solution: a parameter is neither observed nor has a prior."""


@runtime_checkable
class NormalSystem(Protocol):
    """Gradient and curvature at a point; vectors hold the parameters first, then the free field."""

    @property
    def gradient(self) -> np.ndarray:
        """Gradient of the cost."""
        ...

    def diagonal(self) -> np.ndarray:
        """Diagonal of the curvature."""
        ...

    def curvature_along(self, vector: np.ndarray) -> float:
        """vector . H . vector."""
        ...

    def newton_step(self) -> np.ndarray:
        """The Gauss-Newton step; raises ``SingularSystemError``."""
        ...


@dataclass(frozen=True, eq=False)
class DenseSystem:
    """Curvature H (Q, Q) and gradient (Q,) of a short vector."""

    H: Float[np.ndarray, "Q Q"]
    gradient: Float[np.ndarray, " Q"]

    def diagonal(self) -> np.ndarray:
        """Diagonal of H."""
        return np.diag(self.H).copy()

    def curvature_along(self, vector: np.ndarray) -> float:
        """vector . H . vector."""
        return float(vector @ (self.H @ vector))

    def newton_step(self) -> np.ndarray:
        """-H^-1 gradient by Cholesky."""
        return -_positive_solve(self.H, self.gradient)


@dataclass(frozen=True, eq=False)
class ArrowSystem:
    """A sparse block, the same for x, y, z, bordered by a few dense columns (equation 5 of the MANO paper).

    Attributes:
        sparse: (n, n) curvature of the free field per axis, positive definite.
        cross: (3 n, Q) curvature between free field and parameters.
        H: (Q, Q) curvature of the parameters.
        free_gradient: (n, 3).
        parameter_gradient: (Q,).
    """

    sparse: sp.csr_matrix
    cross: Float[np.ndarray, "n3 Q"]
    H: Float[np.ndarray, "Q Q"]
    free_gradient: Float[np.ndarray, "n 3"]
    parameter_gradient: Float[np.ndarray, " Q"]

    @cached_property
    def gradient(self) -> np.ndarray:
        """Parameters first, then the free field, flat."""
        return np.concatenate([self.parameter_gradient, self.free_gradient.ravel()])

    def diagonal(self) -> np.ndarray:
        """Diagonal of the whole curvature."""
        return np.concatenate([np.diag(self.H), np.repeat(self.sparse.diagonal(), 3)])

    def curvature_along(self, vector: np.ndarray) -> float:
        """vector . H . vector over both parts."""
        x, v = vector[: len(self.H)], vector[len(self.H) :]
        sparse_v = PerAxisCurvature(self.sparse).times(v[:, None])[:, 0]
        return float(x @ (self.H @ x) + 2 * v @ (self.cross @ x) + v @ sparse_v)

    def newton_step(self) -> np.ndarray:
        """Eliminate the sparse block, solve the small dense corner, substitute back."""
        n, Q = self.sparse.shape[0], len(self.H)
        right = np.concatenate([self.cross.reshape(n, 3 * Q), self.free_gradient], axis=1)
        try:
            solved = factorised(self.sparse).solve(right)
        except ArithmeticError as error:
            raise SingularSystemError(str(error)) from error
        solved_cross = solved[:, : 3 * Q].reshape(3 * n, Q)
        solved_gradient = solved[:, 3 * Q :].ravel()
        corner = self.H - self.cross.T @ solved_cross
        x = -_positive_solve(corner, self.parameter_gradient - self.cross.T @ solved_gradient)
        return np.concatenate([x, -solved_gradient - solved_cross @ x])


def _positive_solve(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Cholesky solve with unit-diagonal scaling; parameters mix metres, radians and coefficients."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    scaled = matrix * scale[:, None] * scale[None, :]
    try:
        factor = scipy.linalg.cho_factor(scaled, check_finite=False)
    except np.linalg.LinAlgError as error:
        raise SingularSystemError("normal equations are not positive definite") from error
    return scale * scipy.linalg.cho_solve(factor, scale * right, check_finite=False)
