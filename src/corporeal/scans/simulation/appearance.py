"""Skin colours: several tones, slow blotches, paler palms."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from corporeal.scans.simulation.identities import slow_waves

# From light to dark, red, green and blue; green never reaches red, so that no skin counts as a green object.
SKIN_TONES = np.array(
    [
        [236.0, 196, 176],
        [222, 172, 146],
        [198, 146, 118],
        [166, 116, 90],
        [124, 84, 64],
        [88, 60, 48],
    ]
)
_BLOTCH = np.array([5.0, 8.0, 7.0])
_PALER = 0.16


def skin_colours(
    rest: Float[np.ndarray, "V 3"], rest_normals: Float[np.ndarray, "V 3"], tone: int, seed: int
) -> Float[np.ndarray, "V 3"]:
    """Colour of every vertex, 0 to 255.

    Args:
        rest: skin at rest, metres, palm down: colours stay on the skin as it moves.
        rest_normals: its normals.
        tone: number of the skin tone.
        seed: of the person's blotches.
    """
    base = SKIN_TONES[tone]
    blotches = slow_waves(rest, np.random.default_rng([seed, 7]))[:, None] * _BLOTCH * (base / 220)
    palm = np.clip(-rest_normals[:, 1:2], 0, 1) * _PALER * (1 - base / 255)
    return np.clip(base * (1 + palm) + blotches, 4, 250)
