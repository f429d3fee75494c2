"""The few morph targets that stand for a sequence's pose correctives."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from corporeal.export.gltf_morphs import MorphTargets
from corporeal.geometry.rotations_numeric import matrix_from_axis_angle
from corporeal.model.surface_model import SurfaceModel

_BATCH = 32
# A target's displacement of a vertex below this (metres, at the largest weight) is stored as zero: 16 targets
# then err by at most 0.08 mm together, which the stated error holds.
_NEGLIGIBLE = 5e-6


@dataclass(frozen=True, eq=False)
class PrincipalCorrectives:
    """The targets, and what they leave out.

    Attributes:
        targets: T targets at n keys.
        largest_error_mm: distance of a vertex from its place with all correctives, largest over all vertices
            and keys, at the zero pose. Skinning, a mean of rotations, makes it no larger.
        largest_without_mm: the same without any target: how large the correctives are.
    """

    targets: MorphTargets
    largest_error_mm: float
    largest_without_mm: float


def principal_correctives(
    model: SurfaceModel, poses: Float[np.ndarray, "n K 3"], *, most: int, tolerance: float
) -> PrincipalCorrectives:
    """Principal components of the pose correctives (equation 3 of the MANO paper) over the keys.

    The offsets F D^T would be n times 3 V numbers. Their principal directions follow from F^T F
    and D^T D alone (P x P), so that memory does not grow with the sequence: with F^T F = L L^T, they are
    D L w, where w are the eigenvectors of L^T D^T D L.

    Args:
        model: whose correctives are wanted.
        poses: axis-angle of all joints at every key, radians.
        most: number of targets at most.
        tolerance: the fewest targets are taken whose largest error is below this, metres.
    """
    V = model.vertex_count
    if not model.has_correctives:
        return PrincipalCorrectives(
            MorphTargets((), np.zeros((0, V, 3)), np.zeros((len(poses), 0))), 0.0, 0.0
        )
    D = model.pose_directions.reshape(3 * V, -1)
    second = np.zeros((D.shape[1], D.shape[1]))
    for features in _feature_batches(poses):
        second += features.T @ features
    directions, readout = _directions(D, second, most)
    reach = np.zeros(len(directions))
    for features in _feature_batches(poses):
        reach = np.maximum(reach, np.abs(features @ readout).max(axis=0))
    # Weights between -1 and 1, as sliders of viewers expect them.
    kept = reach > 0
    reach, readout = reach[kept], readout[:, kept] / reach[kept]
    displacements = directions[kept].reshape(-1, V, 3) * reach[:, None, None]
    displacements[np.linalg.norm(displacements, axis=2) < _NEGLIGIBLE] = 0
    errors = _largest_errors(D, displacements, readout, poses)
    enough = np.flatnonzero(errors <= tolerance)
    count = int(enough[0]) if len(enough) else len(displacements)
    weights = np.concatenate([features @ readout[:, :count] for features in _feature_batches(poses)])
    names = tuple(f"pose_corrective_{index:02d}" for index in range(count))
    targets = MorphTargets(names, displacements[:count], weights)
    return PrincipalCorrectives(targets, 1e3 * float(errors[count]), 1e3 * float(errors[0]))


def pose_features(poses: Float[np.ndarray, "n K 3"]) -> Float[np.ndarray, "n P"]:
    """Elements of the rotations of the joints after the root, minus the identity, row-major."""
    n, K, _ = poses.shape
    rotations = matrix_from_axis_angle(poses[:, 1:].reshape(-1, 3)).reshape(n, K - 1, 3, 3)
    return (rotations - np.eye(3)).reshape(n, 9 * (K - 1))


def _feature_batches(poses: np.ndarray) -> Iterator[np.ndarray]:
    for first in range(0, len(poses), _BATCH):
        yield pose_features(poses[first : first + _BATCH])


def _directions(D: np.ndarray, second: np.ndarray, most: int) -> tuple[np.ndarray, np.ndarray]:
    """(T, 3 V) orthonormal directions, and (P, T) that reads their weights off the features."""
    values, vectors = np.linalg.eigh(second)
    root = vectors * np.sqrt(np.clip(values, 0, None))
    gram = D.T @ D
    squares, turned = np.linalg.eigh(root.T @ gram @ root)
    order = np.argsort(-squares, kind="stable")[:most]
    # Below this the square root of a rounding error.
    order = order[squares[order] > 1e-12 * max(float(squares.max(initial=0)), 1e-30)]
    mixing = root @ turned[:, order] / np.sqrt(squares[order])
    # The sign is free; the largest element decides it, so that it does not depend on the library.
    signs = np.sign(mixing[np.abs(mixing).argmax(axis=0), np.arange(mixing.shape[1])])
    mixing = mixing * signs
    return (D @ mixing).T, gram @ mixing


def _largest_errors(
    D: np.ndarray, displacements: np.ndarray, readout: np.ndarray, poses: np.ndarray
) -> Float[np.ndarray, " T1"]:
    """Largest error over vertices and keys with the first 0, 1, ..., T targets, metres."""
    T, V, _ = displacements.shape
    largest = np.zeros(T + 1)
    for features in _feature_batches(poses):
        weights = features @ readout
        left = (features @ D.T).reshape(len(features), V, 3)
        for count in range(T + 1):
            squares = np.einsum("nvd,nvd->nv", left, left)
            largest[count] = max(largest[count], float(squares.max(initial=0)))
            if count < T:
                left -= weights[:, count, None, None] * displacements[count]
    return np.sqrt(largest)
