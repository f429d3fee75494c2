"""Proportions that no phenotype varies: lengths of phalanges, girths of fingers, width and depth of the palm.

Bones stretch along their axes and carry what follows: unlike the open hand's shape space, where a finger is
long or short as a whole, so that a learned or given space does not hold these people.
"""

from __future__ import annotations

import numpy as np

# Standard deviations as shares.
_PHALANX, _GIRTH, _PALM_DEPTH, _PALM_WIDTH = 0.04, 0.05, 0.05, 0.03
_MOST = 2.0
# The palm's changes grow in over this distance from the wrist, so that the forearm keeps its own.
_GROWN_IN = 0.04
_HAND = 1


def varied(
    vertices: np.ndarray, joints: np.ndarray, weights: np.ndarray, generator: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V, 3) and joints (22, 3: 17 heads, 5 tips) of one person with proportions drawn at random."""
    drawn = np.clip(generator.normal(size=22), -_MOST, _MOST)
    lengths = _PHALANX * drawn[:15].reshape(5, 3)
    girths, (depth, width) = _GIRTH * drawn[15:20], np.array([_PALM_DEPTH, _PALM_WIDTH]) * drawn[20:]
    moved = np.tile(vertices[None], (17, 1, 1))
    moved[_HAND] = _palm(vertices, depth, width)
    new = joints.copy()
    for finger in range(5):
        first = 2 + 3 * finger
        chain = np.vstack([joints[first : first + 3], joints[17 + finger]])
        heads = _palm(chain[:1], depth, width)
        for k in range(3):
            bone = chain[k + 1] - chain[k]
            axis = bone / np.linalg.norm(bone)
            offset = vertices - chain[k]
            along = (offset @ axis)[:, None] * axis
            moved[first + k] = (
                heads[k] + (1 + lengths[finger, k]) * along + (1 + girths[finger]) * (offset - along)
            )
            heads = np.vstack([heads, heads[k] + (1 + lengths[finger, k]) * bone])
        new[first : first + 3], new[17 + finger] = heads[:3], heads[3]
    return np.einsum("vk,kva->va", weights, moved), new


def _palm(points: np.ndarray, depth: float, width: float) -> np.ndarray:
    share = np.clip(-points[:, 0] / _GROWN_IN, 0, 1)
    share = share * share * (3 - 2 * share)
    return points * (1 + share[:, None] * np.array([0, depth, width]))
