"""A posed surface back to the zero pose: skinning undone vertex by vertex."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from corporeal.geometry.rotations_numeric import matrix_from_axis_angle
from corporeal.model.jacobian import evaluate
from corporeal.model.surface_model import SurfaceModel
from corporeal.terms.model_fields import ModelParameters


def unposed(
    model: SurfaceModel, vertices: Float[np.ndarray, "V 3"], parameters: ModelParameters
) -> Float[np.ndarray, "V 3"]:
    """The template (metres, zero pose) that the model poses to ``vertices``, pose correctives taken off.

    Joints are those of the parameters' shape. The inverse of equations 2-4 of Romero et al. 2017.
    """
    posed = evaluate(model, parameters.shape, parameters.pose, parameters.translation)
    count = len(parameters.shape)
    shaped = model.template + model.shape_directions[:, :, :count] @ parameters.shape
    rest = model.joint_regressor @ shaped
    turned = posed.T_world_joint[:, :3, :3]
    offsets = posed.T_world_joint[:, :3, 3] - np.einsum("kab,kb->ka", turned, rest)
    weights = model.skinning_weights
    rotation = np.einsum("vk,kab->vab", weights, turned)
    offset = weights @ offsets
    template = np.linalg.solve(rotation, (vertices - offset)[:, :, None])[:, :, 0]
    if model.has_correctives:
        rotations = matrix_from_axis_angle(np.asarray(parameters.pose[1:], dtype=np.float64))
        template = template - model.pose_directions @ (rotations - np.eye(3)).ravel()
    return template
