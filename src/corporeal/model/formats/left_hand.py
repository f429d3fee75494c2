"""The known fault of left-hand MANO files: the x component of every shape direction was never mirrored.

Official left and right hands have the same vertices in mirrored places, so that a sound left file has the
right file's shape directions with x negated; the faulty one has them as they are (smplx, issue 48).
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from corporeal.model.surface_model import SurfaceModel

LeftHandVerdict = Literal["sound", "faulty", "unrelated"]

# Left and right files were not made from the same numbers to the last bit; faulty against sound differ by 2.
_TOLERANCE = 0.1


def check_left_hand(left: SurfaceModel, right: SurfaceModel) -> LeftHandVerdict:
    """Compare the shape directions of a left hand with those of the right hand of the same model.

    Returns:
        "sound": x is mirrored; "faulty": it is not; "unrelated": the two are no pair.

    Raises:
        ValueError: the sides are not left and right.
    """
    if left.side != "left" or right.side != "right":
        raise ValueError(f"expected a left and a right hand, got {left.side} and {right.side}")
    if left.shape_directions.shape != right.shape_directions.shape:
        return "unrelated"
    left_x, right_x = left.shape_directions[:, 0], right.shape_directions[:, 0]
    size = np.linalg.norm(left_x) + np.linalg.norm(right_x)
    if size == 0:
        return "sound"
    if np.linalg.norm(left_x + right_x) < _TOLERANCE * size:
        return "sound"
    if np.linalg.norm(left_x - right_x) < _TOLERANCE * size:
        return "faulty"
    return "unrelated"


def repaired_left_hand(left: SurfaceModel) -> SurfaceModel:
    """The left hand with the x component of every shape direction negated; call it on faulty ones only."""
    notes = dict(left.notes) | {"left_hand": "x of the shape directions mirrored (smplx issue 48)"}
    return left.replace(shape_directions=left.shape_directions * [[[-1.0], [1.0], [1.0]]], notes=notes)
