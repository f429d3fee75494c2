"""Bones as rods in flesh: distances to their axes, and the hinges between them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation


def to_segment(
    points: Float[np.ndarray, "n 3"], head: Float[np.ndarray, "3"], end: Float[np.ndarray, "3"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Distance to a segment, and where along it (0 to 1, beyond at the ends)."""
    along = (points - head) @ (end - head) / ((end - head) @ (end - head))
    nearest = head + np.clip(along, 0, 1)[:, None] * (end - head)
    return np.linalg.norm(points - nearest, axis=1), along


def hinge_motions(
    motions: Float[np.ndarray, "K 4 4"],
    joints: Float[np.ndarray, "_ 3"],
    parents: Int[np.ndarray, " K"],
    hinges: Sequence[int],
) -> Float[np.ndarray, "h 4 4"]:
    """Motion from rest of the ends of bones in joints, which turn half as far as the bone that follows.

    Args:
        motions: of the bones from rest.
        joints: where the bones begin at rest; the first K are read.
        parents: of the bones.
        hinges: the bones whose beginnings are asked for.
    """
    halves = np.tile(np.eye(4), (len(hinges), 1, 1))
    for h, bone in enumerate(hinges):
        parent = motions[parents[bone]]
        turn = Rotation.from_matrix(parent[:3, :3].T @ motions[bone, :3, :3]).as_rotvec()
        half = Rotation.from_rotvec(turn / 2).as_matrix()
        centre = joints[bone]
        halves[h, :3, :3] = parent[:3, :3] @ half
        halves[h, :3, 3] = parent[:3, :3] @ (centre - half @ centre) + parent[:3, 3]
    return halves
