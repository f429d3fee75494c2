"""Pose correctives of the body's joints from settled bends, by the step that ``corporeal learn`` takes.

Of a learning's variables only the correctives are unknown here: templates, joints, poses and skinning weights
are the simulation's own. Hands, jaw and eyes keep the correctives they have.
"""

from __future__ import annotations

import numpy as np
import settled_bends
from settled_bends import SettledBends, fitted, learning_state

from corporeal.learning.joint_distances import geodesic_joint_distances
from corporeal.model.surface_model import SurfaceModel

from .bend_truth import with_mirror_images
from .soft_person import rigid_weights
from .symmetry import MIRROR

# The body's joints without jaw, eyes and fingers.
JOINTS = 22
# Of equation 10. A hand's is 5; the inverse square of a body's size alone would ask for 0.05, which left 2.07
# mm of held-out bends, 0.005 left 1.42 mm and this 1.29 mm (docs/body_correctives.md).
STRENGTH = 0.0007
# Vertices farther from a joint than this along the skin have no corrective of it, metres beyond the nearest.
_REACH = 0.22
# A vertex that linear skinning leaves this near the flesh in all bends has no corrective, metres.
_STILL = 0.2e-3
# Smaller numbers are left out, metres: on held-out bends they were worth less than 0.01 mm together.
_SMALLEST = 3e-4
_SWEEPS = 3
_FORBIDDEN = 1e3


def learned_correctives(
    model: SurfaceModel, bends: SettledBends, strength: float = STRENGTH, smallest: float = _SMALLEST
) -> np.ndarray:
    """(V, 3, 9 K - 9) metres per rotation-matrix element: those of the body's joints learned, others kept."""
    bends, weights = with_mirror_images(bends, model), _weights(model)
    plain = model.replace(pose_directions=np.zeros_like(model.pose_directions))
    moved = np.abs(bends.surfaces - posed_surfaces(plain, bends)).max((0, 2)) > _STILL
    moved |= moved[np.asarray(model.mirror_vertices)]
    chosen = np.flatnonzero(moved)
    state, data = learning_state(model, bends, weights, chosen)
    state = fitted(state, data, _costs(model)[:, chosen], strength, _SWEEPS)
    found = state.pose_directions.reshape(JOINTS - 1, 9, len(chosen), 3).transpose(2, 3, 0, 1)
    directions = np.zeros((model.vertex_count, 3, len(model.parents) - 1, 9))
    directions[chosen, :, : JOINTS - 1] = found
    directions = _symmetric(directions, model)
    directions[np.abs(directions) < smallest] = 0
    kept = np.asarray(model.pose_directions).reshape(directions.shape)
    directions[:, :, JOINTS - 1 :] = kept[:, :, JOINTS - 1 :]
    return directions.reshape(model.vertex_count, 3, -1)


def posed_surfaces(model: SurfaceModel, bends: SettledBends) -> np.ndarray:
    """(N, V, 3) the model in the poses that were reached, around the people's own templates."""
    return settled_bends.posed_surfaces(model, bends, _weights(model))


def _weights(model: SurfaceModel) -> np.ndarray:
    """(V, JOINTS) of the body's joints."""
    return rigid_weights(model.skinning_weights)[:, :JOINTS]


def _costs(model: SurfaceModel) -> np.ndarray:
    """(JOINTS - 1, V) geodesic distances from the joints, metres; beyond all bounds where none is wanted."""
    distances = geodesic_joint_distances(model.template, model.faces, model.joint_regressor[:JOINTS])[1:]
    nearest = distances.min(axis=1, keepdims=True)
    return np.where(distances < nearest + _REACH, distances, _FORBIDDEN)


def _symmetric(directions: np.ndarray, model: SurfaceModel) -> np.ndarray:
    """The mean with the mirror image; the data are symmetric, the heat method nearly."""
    vertices, joints = np.asarray(model.mirror_vertices), np.asarray(model.mirror_joints)
    signs = MIRROR[:, None, None, None] * np.outer(MIRROR, MIRROR)[None, None]
    image = directions[vertices][:, :, joints[1:] - 1].reshape(*directions.shape[:3], 3, 3)
    return (directions + (image * signs).reshape(directions.shape)) / 2
