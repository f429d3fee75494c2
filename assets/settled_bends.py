"""Settled bends of several people, hands or bodies, and the correctives that are learned from them.

Templates, joints, poses and skinning weights are the bends' own, so that only correctives are unknown.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from corporeal.geometry.rotations_numeric import matrix_from_axis_angle
from corporeal.learning import skinning_kernels as kernels
from corporeal.learning.correctives import fit_correctives
from corporeal.learning.objective import Priors
from corporeal.learning.options import LearningOptions
from corporeal.learning.state import LearningState, Registrations
from corporeal.model.surface_model import SurfaceModel


@dataclass(frozen=True, eq=False)
class SettledBends:
    """N settled surfaces of H people, the root neither turned nor moved.

    Attributes:
        surfaces: (N, V, 3) metres.
        poses: (N, K, 3) axis-angle that was reached, radians.
        people: (N,) number of the person.
        templates: (H, V, 3) their skins at the zero pose, metres.
        volume_ratios: (N,) of the flesh against rest.
    """

    surfaces: np.ndarray
    poses: np.ndarray
    people: np.ndarray
    templates: np.ndarray
    volume_ratios: np.ndarray

    def subset(self, rows: np.ndarray) -> SettledBends:
        """Some of them; all people stay."""
        return SettledBends(
            self.surfaces[rows], self.poses[rows], self.people[rows], self.templates, self.volume_ratios[rows]
        )


def people_of(model: SurfaceModel, count: int, seed: int, spread: float = 0.8) -> np.ndarray:
    """(count, V, 3) templates: the model's own first, then drawn ones."""
    shapes = spread * np.random.default_rng(seed).normal(size=(count, model.shape_count))
    shapes[0] = 0
    return model.template + np.einsum("vas,hs->hva", model.shape_directions, shapes)


def learning_state(
    model: SurfaceModel, bends: SettledBends, weights: np.ndarray, chosen: np.ndarray | slice = slice(None)
) -> tuple[LearningState, Registrations]:
    """All but the correctives, of some vertices and of the first joints, those of ``weights`` (V, k)."""
    count, joints = len(bends.poses), weights.shape[1]
    rotations = matrix_from_axis_angle(bends.poses[:, :joints].reshape(-1, 3)).reshape(count, joints, 3, 3)
    regressor, templates = model.joint_regressor[:joints], np.ascontiguousarray(bends.templates[:, chosen])
    state = LearningState(
        templates=templates,
        joints=np.stack([regressor @ template for template in bends.templates]),
        weights=weights[chosen],
        pose_directions=np.zeros((9 * (joints - 1), 3 * templates.shape[1])),
        regressor=regressor,
        rotations=rotations,
        translations=np.zeros((count, 3)),
        parents=np.asarray(model.parents[:joints], dtype=np.int64),
    )
    surfaces = np.ascontiguousarray(bends.surfaces[:, chosen], dtype=np.float64)
    return state, Registrations(surfaces, bends.people, np.ones(count))


def fitted(
    state: LearningState, data: Registrations, distances: np.ndarray, strength: float, sweeps: int
) -> LearningState:
    """The state with correctives, held by equation 10 over ``distances`` (k - 1, V) to the joints, metres."""
    turns = np.zeros((len(state.templates), len(state.parents), 3, 3))
    priors = Priors(state.templates, state.weights, turns, distances)
    for _ in range(sweeps):
        state = fit_correctives(state, data, priors, LearningOptions(corrective_strength=strength))
    return state


def posed_surfaces(model: SurfaceModel, bends: SettledBends, weights: np.ndarray) -> np.ndarray:
    """(N, V, 3) the model in the poses that were reached, around the people's own templates."""
    state, data = learning_state(model, bends, weights)
    features = 9 * (weights.shape[1] - 1)
    directions = np.asarray(model.pose_directions, dtype=np.float64)[:, :, :features]
    by_feature = directions.reshape(-1, features).T
    state = replace(state, pose_directions=np.ascontiguousarray(by_feature))
    surfaces, table = np.empty_like(bends.surfaces, dtype=np.float64), state.weight_table()
    for posed in state.posed(data):
        kernels.posed_vertices(table, posed.motions, posed.rest, surfaces[posed.rows])
    return surfaces
