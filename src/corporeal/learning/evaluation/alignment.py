"""Rigid alignment of corresponding points."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from corporeal.registration.starts import similarity


def rigid_onto(
    source: Float[np.ndarray, "N 3"], target: Float[np.ndarray, "N 3"]
) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]]:
    """Rotation and translation (metres) that take source to target by least squares."""
    _, R, _ = similarity(source, target, np.ones(len(source)))
    return R, target.mean(axis=0) - R @ source.mean(axis=0)
