"""Geman-McClure: a squared distance that stops counting once it is far beyond its scale."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float


def geman_mcclure(
    squared: Float[np.ndarray, " n"], scale: float
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Value and weight of rho(r) = s^2 r^2 / (s^2 + r^2) (Geman and McClure 1987).

    Args:
        squared: squared residuals, in squared units of ``scale``.
        scale: s; infinite gives the plain square.

    Returns:
        rho, and d rho / d (r^2), which is 1 at zero and falls to 0: the weight of iteratively reweighted
        least squares.
    """
    if np.isinf(scale):
        return squared.copy(), np.ones_like(squared)
    square = scale * scale
    share = square / (square + squared)
    return share * squared, share * share
