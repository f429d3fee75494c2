"""A posed surface back to the zero pose: skinning undone vertex by vertex."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from corporeal.model.jacobian import evaluate
from corporeal.model.surface_model import SurfaceModel
from corporeal.terms.model_fields import ModelParameters

# An elbow bent by 90 degrees folds the skin between its bones to 0.7, by 135 to 0.4. Fully enlarged, what a
# frame's free vertices were off by there stood out of the template as a spike of 20 mm.
_UNFOLDED = 0.7


def unposed(
    model: SurfaceModel, vertices: Float[np.ndarray, "V 3"], parameters: ModelParameters
) -> Float[np.ndarray, "V 3"]:
    """The template (metres, zero pose) that the model poses to ``vertices``, pose correctives taken off.

    Joints are those of the parameters' shape. The inverse of equations 2-4 of Romero et al. 2017, but for
    directions in which skinning has folded skin to less than ``_UNFOLDED`` of its size: there what the
    vertices say beyond the model is not enlarged but fades, to nothing where nothing is left.
    """
    posed = evaluate(model, parameters.shape, parameters.pose, parameters.translation)
    count = len(parameters.shape)
    shaped = model.template + model.shape_directions[:, :, :count] @ parameters.shape
    beyond = vertices - posed.vertices
    rotation = np.einsum("vk,kab->vab", model.skinning_weights, posed.T_world_joint[:, :3, :3])
    left, size, right = np.linalg.svd(rotation)
    enlarged = size / np.maximum(size, _UNFOLDED) ** 2
    return shaped + np.einsum("vba,vb,vcb,vc->va", right, enlarged, left, beyond)
