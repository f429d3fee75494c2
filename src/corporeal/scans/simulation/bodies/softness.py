"""Flesh that follows late, as damped springs, and muscles that swell as joints bend."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

# Belly, left and right breast, left and right buttock: the bone that carries each, its own frequency in Hz.
CARRIERS = ("spine04", "spine02", "spine02", "upperleg01.L", "upperleg01.R")
_FREQUENCY = np.array([3.2, 3.6, 3.6, 4.5, 4.5])
_DAMPING = 0.3  # share of the critical one
_FARTHEST = 0.03  # metres
_SUBSTEPS = 8
# Biceps and calves: the joints whose bending makes them swell, and by how much at a right angle, metres.
_BENT = (18, 19, 4, 5)
_SWELLING = np.array([7e-3, 7e-3, 5e-3, 5e-3])


def soft_offsets(
    places: Float[np.ndarray, "N 5 3"], softness: float, fps: float
) -> Float[np.ndarray, "N 5 3"]:
    """How far soft parts are from where their bones carry them, metres, in the world.

    Args:
        places: of the carrying bones.
        softness: factor on the way.
        fps: frames per second.
    """
    acceleration = np.zeros_like(places)
    if len(places) > 2:
        acceleration[1:-1] = (places[2:] - 2 * places[1:-1] + places[:-2]) * fps**2
        acceleration[0], acceleration[-1] = acceleration[1], acceleration[-2]
    rate = 2 * np.pi * _FREQUENCY[:, None]
    step = 1 / (fps * _SUBSTEPS)
    # The first frame is in balance with its acceleration, or every sequence would begin with a swing.
    offset, speed = -acceleration[0] / rate**2, np.zeros((5, 3))
    found = np.empty_like(places)
    for frame, pushed in enumerate(acceleration):
        for _ in range(_SUBSTEPS):
            speed += step * (-pushed - rate**2 * offset - 2 * _DAMPING * rate * speed)
            offset = offset + step * speed
        found[frame] = offset
    length = np.linalg.norm(found, axis=2, keepdims=True)
    farthest = softness * _FARTHEST
    return found * (farthest * np.tanh(softness * length / farthest) / np.maximum(length, 1e-9))


def muscle_heights(pose: Float[np.ndarray, "55 3"]) -> Float[np.ndarray, "4"]:
    """How far biceps and calves rise, metres."""
    angles = np.linalg.norm(pose[list(_BENT)], axis=1)
    return _SWELLING * np.minimum(np.sin(angles / 2) ** 2 / 0.5, 1.6)
