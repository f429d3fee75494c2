"""Starts without landmarks: orientations tried in turn, each settled by rigid closest points.

The slow way, for machines without the detector: the hand is laid against the scan in every orientation of a
coarse grid, tips first, and the few that lie closest go on to a real fit.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from corporeal.model.jacobian import evaluate
from corporeal.model.surface_model import SurfaceModel
from corporeal.registration.options import RegistrationOptions
from corporeal.registration.stages import Fitter
from corporeal.registration.starts import mean_pose, similarity, turned
from corporeal.registration.target import Target
from corporeal.scans.scan import Scan

_DIRECTIONS = 12
_ROLLS = 8
_ITERATIONS = 15
_KEPT = 4
_VERTICES = 400


def search_starts(
    model: SurfaceModel, scan: Scan, options: RegistrationOptions
) -> Iterator[tuple[Fitter, Float[np.ndarray, " Q"]]]:
    """The rigid placements of the mean pose that lie closest to the scan, best first.

    With the unit "free" every placement has its own scale, and the scan is brought to the model's.
    """
    shape = np.zeros(min(options.shape_count, model.shape_count))
    poses = [mean_pose(model), np.zeros((model.joint_count, 3))]
    target = Target(scan)
    tree = cKDTree(target.samples.first(4000).positions)
    ranked = []
    for pose in poses:
        vertices = evaluate(model, shape, pose, np.zeros(3)).vertices
        picked = vertices[np.linspace(0, len(vertices) - 1, _VERTICES).astype(np.int64)]
        for R, t in _placements(picked, np.asarray(tree.data)):
            cost, scale, R_best, t_best = _settled(picked, tree, R, t, free_scale=scan.unit.name == "free")
            ranked.append((cost, scale, pose, R_best, t_best))
    ranked.sort(key=lambda entry: entry[0])
    for _, scale, pose, R, t in ranked[:_KEPT]:
        scaled = scan if scale == 1.0 else scan.with_scale(scan.unit.metres_per_unit / scale)
        fitter = Fitter(model, target if scale == 1.0 else Target(scaled), None, options)
        yield fitter, turned(model, pose, shape, R, t / scale)


def _placements(
    vertices: Float[np.ndarray, "v 3"], points: Float[np.ndarray, "n 3"]
) -> Iterator[tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]]]:
    """Rotations of a grid, each with the model's foremost point on the scan's foremost point."""
    centred = points - points.mean(0)
    axis = np.linalg.svd(centred, full_matrices=False)[2][0]
    grid = np.vstack([axis, -axis, _sphere(_DIRECTIONS)])
    forward = np.linalg.svd(vertices - vertices.mean(0), full_matrices=False)[2][0]
    for direction in grid:
        first = Rotation.align_vectors(direction[None], forward[None])[0]
        for roll in np.arange(_ROLLS) * 2 * np.pi / _ROLLS:
            R = (Rotation.from_rotvec(roll * direction) * first).as_matrix()
            moved = vertices @ R.T
            tip, end = moved[np.argmax(moved @ direction)], points[np.argmax(points @ direction)]
            sideways = points[points @ direction > end @ direction - np.ptp(moved @ direction)].mean(0)
            across = np.eye(3) - np.outer(direction, direction)
            yield R, direction * ((end - tip) @ direction) + across @ (sideways - moved.mean(0))


def _settled(
    vertices: np.ndarray, tree: cKDTree, R: np.ndarray, t: np.ndarray, *, free_scale: bool
) -> tuple[float, float, np.ndarray, np.ndarray]:
    """Rigid (or similarity) closest-point iterations; cost is the mean distance of the nearer four fifths."""
    scale = 1.0
    distance = np.zeros(len(vertices))
    for _ in range(_ITERATIONS):
        moved = scale * vertices @ R.T + t
        distance, index = tree.query(moved)
        nearer = distance <= np.quantile(distance, 0.8)
        fitted, R, t = similarity(
            vertices[nearer], np.asarray(tree.data)[index[nearer]], np.ones(nearer.sum())
        )
        if free_scale:
            scale = float(np.clip(fitted, 0.7 * scale, 1.4 * scale))
        t = (np.asarray(tree.data)[index[nearer]] - scale * vertices[nearer] @ R.T).mean(0)
    cost = float(np.sort(distance)[: int(0.8 * len(distance))].mean()) / scale
    return cost, scale, R, t


def _sphere(count: int) -> Float[np.ndarray, "n 3"]:
    """Evenly spread directions on a golden spiral."""
    i = np.arange(count) + 0.5
    polar, around = np.arccos(1 - 2 * i / count), np.pi * (1 + 5**0.5) * i
    return np.stack([np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)], axis=1)
