"""Pose correctives of the open hand learned from settled bends, by the step that ``corporeal learn`` takes.

Templates, joints, poses and skinning weights are the bends' own: only the correctives are unknown.
"""

from __future__ import annotations

import numpy as np
from settled_bends import SettledBends, fitted, learning_state, posed_surfaces

from corporeal.learning.joint_distances import geodesic_joint_distances
from corporeal.model.surface_model import SurfaceModel

# Of equation 10, chosen on held-out bends: `learn_hand_correctives.py --choose`.
STRENGTH = 0.05
# Smaller numbers are left out, metres: four fifths of them, for 0.014 mm on held-out bends and half the file.
_SMALLEST = 5e-5
_SWEEPS = 4


def learned_correctives(model: SurfaceModel, bends: SettledBends, strength: float) -> np.ndarray:
    """(V, 3, 135) metres per rotation-matrix element."""
    distances = geodesic_joint_distances(model.template, model.faces, model.joint_regressor)[1:]
    state, data = learning_state(model, bends, _weights(model))
    found = fitted(state, data, distances, strength, _SWEEPS).pose_directions
    found = found.reshape(-1, model.vertex_count, 3)
    found = np.where(np.abs(found) < _SMALLEST, 0, found)
    return np.ascontiguousarray(found.transpose(1, 2, 0))


def distances_to(model: SurfaceModel, bends: SettledBends) -> np.ndarray:
    """(N, V) metres from the settled surfaces to the model in the same poses, around the same templates."""
    return np.linalg.norm(posed_surfaces(model, bends, _weights(model)) - bends.surfaces, axis=2)


def _weights(model: SurfaceModel) -> np.ndarray:
    return np.asarray(model.skinning_weights, dtype=np.float64)
