"""What ``--pictures`` leaves beside a learned model: its components drawn, and the surface to turn."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float

from corporeal.export.component_sheet import pose_sheet, shape_sheet
from corporeal.export.gltf import write_glb
from corporeal.export.sheets import write_sheet
from corporeal.learning.learned import LearnedModel

_SHAPES, _POSES = 5, 10
# The animation ends in a pose that was scanned, more bent than nine of ten.
_BENT = 0.9


def write_pictures(learned: LearnedModel, path: Path) -> list[Path]:
    """Draw the shape and pose components, and write the model as a GLB with its shape components as morphs.

    Args:
        learned: the model.
        path: of the model file; ``hand.npz`` gets ``hand.shape.png``, ``hand.pose.png`` and ``hand.glb``.

    Returns:
        The files; no picture of poses for a model without pose statistics.

    Raises:
        OSError: a file cannot be written.
    """
    model, written = learned.model, []
    if model.shape_count:
        written.append(path.with_suffix(".shape.png"))
        write_sheet(written[-1], shape_sheet(model, min(_SHAPES, model.shape_count)))
    if model.pose_blocks:
        written.append(path.with_suffix(".pose.png"))
        write_sheet(written[-1], pose_sheet(model, min(_POSES, len(model.pose_blocks[0].components))))
    written.append(path.with_suffix(".glb"))
    write_glb(written[-1], model, np.zeros(0), _bent_pose(learned.poses), np.zeros(3))
    return written


def _bent_pose(poses: Float[np.ndarray, "N K 3"]) -> Float[np.ndarray, "K 3"]:
    """A pose of the training registrations, with the root unturned."""
    order = np.argsort(np.square(poses[:, 1:]).sum(axis=(1, 2)), kind="stable")
    pose = poses[order[int(_BENT * (len(order) - 1))]].copy()
    pose[0] = 0
    return pose
