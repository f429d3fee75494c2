"""Starts without landmarks: orientations tried in turn, each settled by rigid closest points.

The slow way, for machines without the detector: the hand is laid against the scan in every orientation of a
coarse grid, tips first, and the few that lie closest go on to a real fit.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from corporeal.model.jacobian import evaluate
from corporeal.model.surface_model import SurfaceModel
from corporeal.registration.options import RegistrationOptions
from corporeal.registration.stages import Fitter
from corporeal.registration.starts import similarity, start_poses, turned
from corporeal.registration.target import Target

_DIRECTIONS = 12
_ROLLS = 8
# All placements get a few iterations, the better ones the rest: settling all of them took three times as long
# and chose the same starts on the real scans.
_FIRST_ITERATIONS, _FIRST_KEPT = 4, 24
_ITERATIONS, _KEPT = 15, 6
_VERTICES = 250
# Scales tried where the file has no unit, against the provisional one that makes the whole scan hand-sized. A
# scale that closest points could change shrinks: they only ask that the model lies on the scan.
_FREE_SCALES = (0.65, 0.8, 1.0, 1.25, 1.55)


@dataclass(frozen=True, eq=False)
class _Placement:
    """The model's vertices v laid at scale R v + t; cost in metres of the model."""

    pose: Float[np.ndarray, "K 3"]
    picked: Float[np.ndarray, "v 3"]
    R: Float[np.ndarray, "3 3"]
    t: Float[np.ndarray, "3"]
    scale: float = 1.0
    cost: float = np.inf


def search_starts(
    model: SurfaceModel, target: Target, options: RegistrationOptions
) -> Iterator[tuple[Fitter, Float[np.ndarray, " Q"]]]:
    """The rigid placements of the start poses that lie closest to the scan, best first.

    With the unit "free" several scales are tried, and the scan is brought to the model's.
    """
    shape = np.zeros(min(options.shape_count, model.shape_count))
    tree = cKDTree(target.samples.first(4000).positions)
    scales = _FREE_SCALES if target.scan.unit.name == "free" else (1.0,)
    points = np.asarray(tree.data)
    placements = []
    for pose in start_poses(model):
        vertices = evaluate(model, shape, pose, np.zeros(3)).vertices
        picked = vertices[np.linspace(0, len(vertices) - 1, _VERTICES).astype(np.int64)]
        for scale in scales:
            grid = _grid(scale * picked, points)
            placements += [_Placement(pose, picked, R, t, scale) for R, t in grid]
    for iterations, kept in ((_FIRST_ITERATIONS, _FIRST_KEPT), (_ITERATIONS, _KEPT)):
        settled = [_settled(placement, tree, iterations) for placement in placements]
        if len(scales) > 1:
            settled = sorted(settled, key=lambda placement: placement.cost)[: 8 * _FIRST_KEPT]
            settled = [_both_ways(placement, points) for placement in settled]
        placements = sorted(settled, key=lambda placement: placement.cost)[:kept]
    for best in placements:
        fitter = Fitter(model, target.scaled(1 / best.scale), None, options)
        yield fitter, turned(model, best.pose, shape, best.R, best.t / best.scale)


def _grid(
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


def _settled(placement: _Placement, tree: cKDTree, iterations: int) -> _Placement:
    """Rigid closest-point iterations at a fixed scale; the cost is the mean of the nearer four fifths."""
    vertices, R, t = placement.scale * placement.picked, placement.R, placement.t
    points = np.asarray(tree.data)
    count = int(0.8 * len(vertices))
    nearer = np.arange(count)
    distance = np.zeros(len(vertices))
    for _ in range(iterations):
        distance, index = tree.query(vertices @ R.T + t)
        nearer = np.argpartition(distance, count)[:count]
        _, R, _ = similarity(vertices[nearer], points[index[nearer]], np.ones(count))
        t = (points[index[nearer]] - vertices[nearer] @ R.T).mean(0)
    return replace(placement, R=R, t=t, cost=float(distance[nearer].mean()) / placement.scale)


def _both_ways(placement: _Placement, points: np.ndarray) -> _Placement:
    """Add the way back, from scan points beyond the wrist to the model: a hand too small leaves them far.

    The wrist is taken where the model's vertices end, against the direction of its fingers.
    """
    moved = placement.scale * placement.picked @ placement.R.T + placement.t
    fingers = placement.R @ np.array([-1.0, 0, 0])
    fingers = fingers if placement.picked[:, 0].mean() < 0 else -fingers
    beyond = points[points @ fingers > np.quantile(moved @ fingers, 0.1)]
    if len(beyond) == 0:
        return replace(placement, cost=np.inf)
    back = float(cKDTree(moved).query(beyond)[0].mean()) / placement.scale
    return replace(placement, cost=placement.cost + back)


def _sphere(count: int) -> Float[np.ndarray, "n 3"]:
    """Evenly spread directions on a golden spiral."""
    i = np.arange(count) + 0.5
    polar, around = np.arccos(1 - 2 * i / count), np.pi * (1 + 5**0.5) * i
    return np.stack([np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)], axis=1)
