"""Morph targets: shape and expression directions, and a basis for the pose correctives of an animation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from corporeal.geometry.rotations_numeric import matrix_from_axis_angle
from corporeal.model.surface_model import SurfaceModel

# Components that move no vertex by more than this (metres) at any key are left out.
_NEGLIGIBLE = 1e-6


@dataclass(frozen=True, eq=False)
class MorphTargets:
    """Displacements of the base mesh; T targets at n keys.

    Attributes:
        names: one per target.
        displacements: (T, V, 3) metres per unit of weight.
        weights: (n, T) weight of every target at every key.
    """

    names: tuple[str, ...]
    displacements: Float[np.ndarray, "T V 3"]
    weights: Float[np.ndarray, "n T"]

    def joined(self, other: MorphTargets) -> MorphTargets:
        """These targets, then the others, at the same keys."""
        return MorphTargets(
            self.names + other.names,
            np.concatenate([self.displacements, other.displacements]),
            np.concatenate([self.weights, other.weights], axis=1),
        )


def coefficient_targets(
    name: str, directions: Float[np.ndarray, "V 3 S"], coefficients: Float[np.ndarray, " s"], keys: int
) -> MorphTargets:
    """One target per direction, at the same weight (its coefficient) at every key.

    Directions beyond the coefficients get weight 0: they are there to be played with.
    """
    count = directions.shape[2]
    weights = np.zeros(count)
    weights[: min(count, len(coefficients))] = coefficients[:count]
    return MorphTargets(
        tuple(f"{name}_{index:02d}" for index in range(count)),
        np.ascontiguousarray(directions.transpose(2, 0, 1)),
        np.tile(weights, (keys, 1)),
    )


def corrective_targets(model: SurfaceModel, poses: Float[np.ndarray, "n K 3"]) -> MorphTargets:
    """Pose correctives at the keys of an animation, in the smallest exact basis.

    One target per pose feature would be 9 (K - 1): 135 for a hand. Along one animation the correctives of n
    keys span at most n dimensions; the singular value decomposition of those n offsets gives targets that
    reproduce every key to 1 um, and weights that are interpolated between keys as everything else in glTF is.

    Args:
        model: whose correctives (equation 3 of the MANO paper) are wanted.
        poses: axis-angle of all joints at every key, radians.
    """
    n, K, _ = poses.shape
    rotations = matrix_from_axis_angle(poses[:, 1:].reshape(-1, 3)).reshape(n, K - 1, 3, 3)
    features = (rotations - np.eye(3)).reshape(n, 9 * (K - 1))
    offsets = features @ model.pose_directions.reshape(3 * model.vertex_count, -1).T
    left, singular, right = np.linalg.svd(offsets, full_matrices=False)
    # Weights between -1 and 1, as sliders of viewers expect them.
    reach = np.abs(left * singular).max(axis=0)
    kept = reach * np.abs(right).max(axis=1) > _NEGLIGIBLE / n
    # By projection instead of left * singular: the zero pose then has weights of exactly zero.
    weights = offsets @ right[kept].T / reach[kept]
    displacements = (right[kept] * reach[kept, None]).reshape(-1, model.vertex_count, 3)
    names = tuple(f"pose_corrective_{index:02d}" for index in range(len(displacements)))
    return MorphTargets(names, displacements, weights)
