"""Pose correctives of the open hand learned from settled bends, by the step that ``corporeal learn`` takes.

Templates, joints, poses and skinning weights are the bends' own: only the correctives are unknown.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from corporeal.geometry.rotations_numeric import matrix_from_axis_angle
from corporeal.learning import skinning_kernels as kernels
from corporeal.learning.correctives import fit_correctives
from corporeal.learning.joint_distances import geodesic_joint_distances
from corporeal.learning.objective import Priors
from corporeal.learning.options import LearningOptions
from corporeal.learning.state import LearningState, Registrations
from corporeal.model.surface_model import SurfaceModel

from .finger_bends import FingerBends

# Of equation 10, chosen on held-out bends: `learn_hand_correctives.py --choose`.
STRENGTH = 0.05
# Smaller numbers are left out, metres: four fifths of them, for 0.014 mm on held-out bends and half the file.
_SMALLEST = 5e-5
_SWEEPS = 4


def learned_correctives(model: SurfaceModel, bends: FingerBends, strength: float) -> np.ndarray:
    """(V, 3, 135) metres per rotation-matrix element."""
    state, data = _state(model, bends)
    distances = geodesic_joint_distances(model.template, model.faces, model.joint_regressor)[1:]
    start = np.zeros((len(bends.templates), model.joint_count, 3, 3))
    priors = Priors(state.templates, state.weights, start, distances)
    options = LearningOptions(corrective_strength=strength)
    for _ in range(_SWEEPS):
        state = fit_correctives(state, data, priors, options)
    found = state.pose_directions.reshape(-1, model.vertex_count, 3)
    found = np.where(np.abs(found) < _SMALLEST, 0, found)
    return np.ascontiguousarray(found.transpose(1, 2, 0))


def distances_to(model: SurfaceModel, bends: FingerBends) -> np.ndarray:
    """(N, V) metres from the settled surfaces to the model in the same poses, around the same templates."""
    state, data = _state(model, bends)
    directions = np.asarray(model.pose_directions, dtype=np.float64)
    by_feature = directions.reshape(-1, directions.shape[2]).T
    state = replace(state, pose_directions=np.ascontiguousarray(by_feature))
    surfaces, table = np.empty_like(bends.surfaces), state.weight_table()
    for posed in state.posed(data):
        kernels.posed_vertices(table, posed.motions, posed.rest, surfaces[posed.rows])
    return np.linalg.norm(surfaces - bends.surfaces, axis=2)


def _state(model: SurfaceModel, bends: FingerBends) -> tuple[LearningState, Registrations]:
    count, K = bends.poses.shape[:2]
    rotations = matrix_from_axis_angle(bends.poses.reshape(-1, 3)).reshape(count, K, 3, 3)
    state = LearningState(
        templates=bends.templates,
        joints=np.stack([model.joint_regressor @ template for template in bends.templates]),
        weights=np.asarray(model.skinning_weights, dtype=np.float64),
        pose_directions=np.zeros((9 * (K - 1), 3 * model.vertex_count)),
        regressor=model.joint_regressor,
        rotations=rotations,
        translations=np.zeros((count, 3)),
        parents=np.asarray(model.parents, dtype=np.int64),
    )
    return state, Registrations(bends.surfaces, bends.hands, np.ones(count))
