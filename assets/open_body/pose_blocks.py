"""Pose blocks of the body in SMPL-X's manner; the hands' statistics are the open hand's."""

from __future__ import annotations

import dataclasses

import numpy as np

from corporeal.model.statistics import PoseBlock, PoseMixture

from .limits import body_limits
from .rig import LEFT_HAND, RIGHT_HAND

_BLOCKS = {"body": tuple(range(1, 22)), "jaw": (22,), "leye": (23,), "reye": (24,)}
# What mirroring does to axis-angle numbers.
_SIGNS = np.tile([1.0, -1, -1], 15)


def body_pose_blocks(hand: PoseBlock) -> tuple[PoseBlock, ...]:
    """Body, jaw and eyes with limits and no statistics; both hands with the open right hand's."""
    limits = body_limits()
    plain = [
        dataclasses.replace(
            PoseBlock.plain(name, joints), limits=np.concatenate([limits[joint - 1] for joint in joints])
        )
        for name, joints in _BLOCKS.items()
    ]
    right = dataclasses.replace(hand, name="right_hand", joints=RIGHT_HAND[1:])
    return (*plain, _left(right), right)


def _left(right: PoseBlock) -> PoseBlock:
    mixture, limits = right.mixture, right.limits
    if mixture is not None:
        covariances = mixture.covariances * np.outer(_SIGNS, _SIGNS)
        mixture = PoseMixture(mixture.weights, mixture.means * _SIGNS, covariances)
    if limits is not None:
        signed = limits * _SIGNS[:, None]
        limits = np.sort(signed, axis=1)
    return dataclasses.replace(
        right, name="left_hand", joints=LEFT_HAND[1:], mean=right.mean * _SIGNS,
        components=right.components * _SIGNS, mixture=mixture, limits=limits,
    )  # fmt: skip
