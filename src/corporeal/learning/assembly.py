"""Putting the learned parts into a model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from corporeal.geometry.rotations_numeric import axis_angle_from_matrix
from corporeal.learning.options import LearningOptions
from corporeal.learning.shape_space import learned_block, principal_components, shape_directions
from corporeal.learning.state import LearningState
from corporeal.model.joint_regressor import same_cut
from corporeal.model.surface_model import SurfaceModel


@dataclass(frozen=True, eq=False)
class Assembly:
    """The model, the poses (N, K, 3) as axis-angle, and explained variances of shape and pose.

    ``shift`` (3,) is what the templates were moved by, metres: the root lies where the start model has it.
    """

    model: SurfaceModel
    shift: Float[np.ndarray, "3"]
    poses: Float[np.ndarray, "N K 3"]
    shape_variances: Float[np.ndarray, " n"]
    pose_variances: Float[np.ndarray, " m"]


def assembled(state: LearningState, start: SurfaceModel, options: LearningOptions) -> Assembly:
    """The learned model; topology, names, parts, landmarks and limits are the start model's."""
    V, K = start.vertex_count, start.joint_count
    shapes = principal_components(state.templates.reshape(len(state.templates), -1))
    template = shapes.mean.reshape(V, 3)
    # A template and all translations may be moved against each other; the start model's place is a
    # convention.
    shift = np.asarray((start.joint_regressor @ start.template)[0] - (state.regressor @ template)[0])
    P = 9 * (K - 1) if options.correctives else 0
    directions = state.pose_directions[:P].reshape(P, V, 3).transpose(1, 2, 0)
    blocks, variances = [], np.zeros(0)
    for number, block in enumerate(start.pose_blocks):
        learned, components = learned_block(block, state.rotations, options.mixture_components, options.seed)
        blocks.append(learned)
        if number == 0:
            variances = components.variances
    model = start.replace(
        template=template + shift,
        shape_directions=shape_directions(
            shapes, options.shape_count, start.shape_directions, options.start_shape_weight
        ),
        joint_regressor=state.regressor,
        skinning_weights=state.weights,
        pose_directions=np.ascontiguousarray(directions),
        pose_blocks=tuple(blocks),
        cut=same_cut(start, state.regressor @ template),
    )
    count = len(state.rotations)
    poses = axis_angle_from_matrix(state.rotations.reshape(-1, 3, 3)).reshape(count, K, 3)
    return Assembly(model, shift, poses, shapes.variances, variances)
