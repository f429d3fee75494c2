"""Pose blocks in a model's parameters, and their first principal components as a subspace of these."""

from __future__ import annotations

import numpy as np

from corporeal.model.jacobian import ParameterColumns
from corporeal.model.statistics import PoseBlock
from corporeal.model.surface_model import SurfaceModel
from corporeal.solve.subspace import AffineSubspace


def block_columns(block: PoseBlock, columns: ParameterColumns) -> slice:
    """Where a block's numbers stand in the parameters.

    Raises:
        ValueError: its joints do not follow one another.
    """
    joints = np.asarray(block.joints)
    if not np.array_equal(joints, np.arange(joints[0], joints[0] + len(joints))):
        raise ValueError(f"pose block {block.name!r}: its joints must follow one another to be solved for")
    start = columns.pose.start + 3 * int(joints[0])
    return slice(start, start + 3 * len(joints))


def pose_subspace(model: SurfaceModel, columns: ParameterColumns, count: int) -> AffineSubspace:
    """Parameters whose pose is the mean and the first ``count`` components of every pose block.

    Translation, root, shape, and blocks without components stay free. Components are counted from the block's
    mean, whatever ``mean_included`` says of the model's coefficients: that is what they are principal about.

    Args:
        model: whose pose blocks hold mean and components.
        columns: of the parameter vector.
        count: components, at most those of the block that has most; a block with fewer gives all of its own.

    Raises:
        ValueError: a negative count, more than there are, or a model without components.
    """
    most = max((len(block.components) for block in model.pose_blocks), default=0)
    if not 0 <= count <= most or most == 0:
        raise ValueError(f"components: expected 0 to {most}, as many as {model.name!r} has, got {count}")
    origin, held = np.zeros(columns.count), np.zeros(columns.count, dtype=bool)
    directions = []
    for block in model.pose_blocks:
        if not len(block.components):
            continue
        numbers = (columns.pose.start + 3 * np.asarray(block.joints)[:, None] + np.arange(3)).ravel()
        origin[numbers] = block.mean
        held[numbers] = True
        spread = np.zeros((columns.count, min(count, len(block.components))))
        spread[numbers] = block.components[:count].T
        directions.append(spread)
    free = np.eye(columns.count)[:, ~held]
    return AffineSubspace(origin, np.concatenate([free, *directions], axis=1))
