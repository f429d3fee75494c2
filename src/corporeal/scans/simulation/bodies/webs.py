"""Webs: a body scanner's pictures are too coarse for the gaps between fingers, and its scans bridge them."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from corporeal.scans.simulation.sampling_pattern import SamplingPattern
from corporeal.scans.simulation.scanner import SampledSurface

# First joints of index, middle, ring and little finger in a hand's 15, three joints a finger.
_NEIGHBOURS = ((0, 3), (3, 9), (9, 6))
_SPACING = 3e-3
# Metres between the middles of fingers that touch, and what a finger is thick.
_TOUCHING, _HALF_THICKNESS = 0.018, 4e-3


def finger_webs(
    hand_joints: Float[np.ndarray, "15 3"], widest: float, colour: Float[np.ndarray, "3"]
) -> tuple[SampledSurface, ...]:
    """Sheets between neighbouring fingers, on the back and on the palm.

    Args:
        hand_joints: of one hand in SMPL-X's order, metres.
        widest: gap between two fingers' skins up to which it is bridged, metres.
        colour: of the skin, 0 to 255.
    """
    sheets = []
    for first, second in _NEIGHBOURS:
        lines = [_along(hand_joints[start : start + 3]) for start in (first, second)]
        near = np.linalg.norm(lines[0] - lines[1], axis=1) < _TOUCHING + widest
        # A web grows from the knuckles and ends where the fingers part.
        length = len(near) if near.all() else int(np.argmin(near))
        if length >= 3:
            sheets += _slab(lines[0][:length], lines[1][:length], colour)
    return tuple(sheets)


def _along(joints: np.ndarray) -> np.ndarray:
    """Points on a finger from its first joint to its last, in as many steps for every finger."""
    steps = np.linspace(0, len(joints) - 1, 16)
    return np.column_stack([np.interp(steps, np.arange(len(joints)), joints[:, axis]) for axis in range(3)])


def _slab(first: np.ndarray, second: np.ndarray, colour: np.ndarray) -> list[SampledSurface]:
    across = second - first
    count = max(3, int(np.ceil(np.linalg.norm(across, axis=1).max() / _SPACING)))
    shares = np.linspace(0.15, 0.85, count)[None, :, None]
    middle = first[:, None] + shares * across[:, None]
    normal = np.cross(np.gradient(first, axis=0) + np.gradient(second, axis=0), across)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    faces = _grid(len(first), count)
    sheets = []
    for sign, turned in ((1, faces), (-1, faces[:, [0, 2, 1]])):
        vertices = (middle + sign * _HALF_THICKNESS * normal[:, None]).reshape(-1, 3)
        colours = np.tile(colour, (len(vertices), 1))
        sheets.append(SampledSurface(vertices, turned, colours, _at_vertices(turned, len(vertices))))
    return sheets


def _grid(rows: int, columns: int) -> np.ndarray:
    """Faces of a grid of vertices; they face the side to which rows x columns points."""
    number = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = (
        part.ravel() for part in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:])
    )
    return np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])


def _at_vertices(faces: np.ndarray, count: int) -> SamplingPattern:
    _, first = np.unique(faces, return_index=True)
    return SamplingPattern(first // 3, np.eye(3)[first % 3], faces[:, :])
