"""Skinning weights and joint regressor of the body; the hands' are the open hand's own."""

from __future__ import annotations

import numpy as np

from .rig import LEFT_HAND, PARENTS, RIGHT_HAND, Stance, joint_groups, mirror_joints

_MOST = 4
_NEAREST, _FURTHEST, _THINNED = 250, 5000, 12


def body_weights(
    source: np.ndarray,
    bones: tuple[str, ...],
    mirror: np.ndarray,
    hand_vertices: np.ndarray,
    hand: np.ndarray,
) -> np.ndarray:
    """(V, 55): bones merged, made symmetric, at most 4 per vertex; fingers as the open hand has them.

    The weight that the open hand gives its wrist is shared between wrist and forearm as in the source.
    """
    index = {bone: i for i, bone in enumerate(bones)}
    merged = np.stack([source[:, [index[b] for b in group]].sum(1) for group in joint_groups()], axis=1)
    merged = (merged + merged[mirror][:, mirror_joints()]) / 2
    rest = merged[hand_vertices]
    rest[:, 40:] = 0
    rest[:, 21] += rest.sum(1) == 0  # finger tips have no share to divide
    rest /= rest.sum(1, keepdims=True)
    own = hand[:, :1] * rest
    own[:, 40:] = hand[:, 1:]
    merged[hand_vertices] = own
    merged[mirror[hand_vertices]] = own[:, mirror_joints()]
    # Strictly more than the fifth: on the middle line left and right are equal, and go together.
    fifth = np.sort(merged, axis=1)[:, -_MOST - 1][:, None]
    kept = np.where(merged > np.maximum(fifth, 1e-4), merged, 0)
    return kept / kept.sum(1, keepdims=True)


def body_regressor(
    stances: list[Stance],
    weights: np.ndarray,
    mirror: np.ndarray,
    hand_vertices: np.ndarray,
    hand: np.ndarray,
) -> np.ndarray:
    """(55, V): SMPL's recipe over all identities; rows of the fingers are the open hand's (16, V_hand).

    The wrist has a row of its own: behind it the body's arm is not the hand's stump.
    """
    mean = np.mean([stance.vertices for stance in stances], axis=0)
    centres = np.mean([stance.joints for stance in stances], axis=0)
    other = mirror_joints()
    regressor = np.zeros((55, len(mean)))
    for j in [j for j in range(25) if j <= other[j]]:
        regressor[j] = _row(stances, mean, centres[j], weights, j)
        if other[j] == j:
            regressor[j] = (regressor[j] + regressor[j][mirror]) / 2
        else:
            regressor[other[j]] = regressor[j][mirror]
    for row, joint in list(enumerate(RIGHT_HAND))[1:]:
        regressor[joint, hand_vertices] = hand[row]
        regressor[LEFT_HAND[row], mirror[hand_vertices]] = hand[row]
    return regressor


def _row(
    stances: list[Stance], mean: np.ndarray, centre: np.ndarray, weights: np.ndarray, j: int
) -> np.ndarray:
    from scipy.optimize import nnls

    own = weights[:, j] + (weights[:, PARENTS[j]] if j else 0) > 0.3
    near = np.argsort(np.where(own, np.linalg.norm(mean - centre, axis=1), np.inf))
    near = near[: int(own.sum())]
    # The nearest alone lie in front of an eye or beside the spine: thinned ones further off close the ring.
    near = np.concatenate([near[:_NEAREST], near[_NEAREST:_FURTHEST:_THINNED]])
    strict, even = 10.0, 1e-3  # as for the hand: a sum of one, and a little pull towards the ring's mean
    A = np.concatenate([stance.vertices[near].T for stance in stances])
    b = np.concatenate([stance.joints[j] for stance in stances])
    A = np.vstack([A, np.full((1, len(near)), strict), even * np.eye(len(near))])
    solution, _ = nnls(A, np.concatenate([b, [strict], np.full(len(near), even / len(near))]))
    row = np.zeros(len(mean))
    row[near] = solution / solution.sum()
    return row
