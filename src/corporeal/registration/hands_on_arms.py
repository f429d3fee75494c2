"""Which part of a body is a hand; a model of a hand alone has none in this sense."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool

from corporeal.model.statistics import PoseBlock
from corporeal.model.surface_model import SurfaceModel


def is_hand_on_arm(model: SurfaceModel, block: PoseBlock) -> bool:
    """Whether a block is of fingers, known by components, with a wrist and an elbow above them."""
    if not len(block.components):
        return False
    wrist = int(model.parents[block.joints[0]])
    return wrist > 0 and int(model.parents[wrist]) > 0


def on_hands(model: SurfaceModel) -> Bool[np.ndarray, " V"]:
    """Vertices that fingers on arms carry: of a body, those of both hands without the wrists."""
    fingers = [block.joints for block in model.pose_blocks if is_hand_on_arm(model, block)]
    joints = [int(joint) for hand in fingers for joint in hand]
    return np.asarray(model.skinning_weights[:, joints].sum(axis=1) > 0.5)
