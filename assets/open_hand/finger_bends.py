"""Which bends the soft hand is put into, and the settled surfaces that correctives are learned from."""

from __future__ import annotations

import numpy as np
from settled_bends import SettledBends, people_of

from corporeal.model.surface_model import SurfaceModel

from .soft_hand import SettledHand, SoftOpenHand

# Degrees: flexion of a finger's three joints; spread and twist of its first.
_LOW, _HIGH = np.array([-18.0, -5, -5]), np.array([82.0, 100, 65])
_SPREAD, _TWIST = 14.0, 6.0
# The thumb's first joint: flexion, spread, twist; flexion of the other two.
_THUMB_LOW, _THUMB_HIGH = np.array([-18.0, -24, -10, -10, -16]), np.array([46.0, 20, 24, 45, 60])
# In half of the bends the four fingers curl together, as hands do; how much each differs then, as a share.
_TOGETHER, _APART = 0.5, 0.2
# A joint stays straight so often.
_STRAIGHT = 0.15


def random_bends(count: int, seed: int) -> np.ndarray:
    """(count, 15, 3) flexion, spread and twist of index, middle, little, ring and thumb, degrees."""
    generator = np.random.default_rng(seed)
    angles = np.zeros((count, 5, 3, 3))
    for pose in angles:
        share = generator.random((4, 3))
        if generator.random() < _TOGETHER:
            share = np.clip(generator.random(3) + _APART * (share - 0.5), 0, 1)
        pose[:4, :, 0] = (_LOW + share * (_HIGH - _LOW)) * (generator.random((4, 3)) > _STRAIGHT)
        pose[:4, 0, 1] = generator.uniform(-_SPREAD, _SPREAD, 4)
        pose[:4, 0, 2] = generator.uniform(-_TWIST, _TWIST, 4)
        thumb = generator.uniform(_THUMB_LOW, _THUMB_HIGH)
        pose[4, 0], pose[4, 1:, 0] = thumb[:3], thumb[3:]
    return angles.reshape(count, 15, 3)


def settled_bends(model: SurfaceModel, counts: tuple[int, ...], seed: int) -> SettledBends:
    """Settle so many bends of each hand: the template first, then drawn ones."""
    templates = people_of(model, len(counts), seed)
    found: list[SettledHand] = []
    for hand, count in enumerate(counts):
        soft = SoftOpenHand(model, templates[hand])
        found += [soft.posed(angles) for angles in random_bends(count, seed + hand)]
    return SettledBends(
        np.array([one.surface for one in found]),
        np.array([one.pose for one in found]),
        np.repeat(np.arange(len(counts)), counts),
        templates,
        np.array([one.volume_ratio for one in found]),
    )
