"""Compactness (figure 12 of Romero et al. 2017): variance of the training set that few components explain."""

from __future__ import annotations

from typing import Literal

import numpy as np
from jaxtyping import Float

from corporeal.learning.evaluation.results import CompactnessCurve, PaperShares

PAPER_POSE = PaperShares((6, 10, 15), (0.81, 0.90, 0.95))
"""Section 5.1 for the pose space; for the shape space the paper has a plot but no numbers."""


def compactness(
    label: str, space: Literal["pose", "shape"], variances: Float[np.ndarray, " n"]
) -> CompactnessCurve:
    """Cumulative shares of the variance.

    Args:
        label: of the curve.
        space: pose variances in square radians of the axis-angle numbers, shape variances in square metres.
        variances: along all principal components, largest first; those that a model file leaves out included,
            since the shares are of their sum.

    Raises:
        ValueError: no variances, negative ones, ones that do not descend, or none above zero.
    """
    total = float(variances.sum()) if len(variances) else 0.0
    if not total > 0 or (variances < 0).any() or (np.diff(variances) > 1e-12 * total).any():
        raise ValueError("variances: expected those along principal components, largest first, not all zero")
    shares = np.minimum(np.cumsum(variances) / total, 1.0)
    return CompactnessCurve(
        label=label,
        space=space,
        components=tuple(range(1, len(variances) + 1)),
        shares=tuple(float(share) for share in shares),
        paper=PAPER_POSE if space == "pose" else None,
    )
