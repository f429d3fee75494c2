"""Another start for a fit that went wrong: every limb tries the poses that the model knows, one at a time.

Most failures of hands are a finger or two that a detector put in the wrong place: the palm lies well, and no
descent leads a straight finger into a curled one across the empty space between.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from corporeal.model.jacobian import evaluate
from corporeal.model.surface_model import SurfaceModel
from corporeal.registration.stages import Fitter
from corporeal.registration.starts import start_poses

_SCAN_POINTS, _MODEL_POINTS = 1500, 600
# Farther than this counts as this far: where the scan has holes a limb is not to be drawn away.
_CAP = 15e-3
_SWEEPS = 2
_TURN = np.deg2rad(14.0)
_PROMISING = 4


def limbs_tried(fitter: Fitter, vector: Float[np.ndarray, " Q"]) -> Float[np.ndarray, " Q"]:
    """The parameters with every limb in the known pose that lies closest to the scan, both ways.

    A limb is what hangs on the root: a finger with its three joints. Root, shape and place stay as they are.
    """
    model, fields = fitter.model, fitter.fields
    parameters = fields.parameters(vector)
    scan = fitter.near_points(vector).first(_SCAN_POINTS).positions
    tree = cKDTree(fitter.target.samples.first(4 * _SCAN_POINTS).positions)
    picked = np.linspace(0, model.vertex_count - 1, _MODEL_POINTS).astype(np.int64)

    def cost(pose: Float[np.ndarray, "K 3"]) -> float:
        vertices = evaluate(model, parameters.shape, pose, parameters.translation).vertices
        there = np.minimum(cKDTree(vertices).query(scan)[0], _CAP).mean()
        return float(there + np.minimum(tree.query(vertices[picked])[0], _CAP).mean())

    pose = parameters.pose.copy()
    best = cost(pose)
    known = known_poses(model)
    for _ in range(_SWEEPS):
        before = best
        for limb in limbs_of(model):
            rotations = [other[limb] for other in known]
            costs = [cost(_replaced(pose, limb, bent)) for bent in rotations]
            promising = [rotations[k] for k in np.argsort(costs)[:_PROMISING]]
            for bent in (*promising, *_turned_at_the_base(np.array(rotations), promising)):
                tried = _replaced(pose, limb, bent)
                found = cost(tried)
                if found < best:
                    best, pose = found, tried
        if best == before:
            break
    moved = vector.copy()
    moved[fields.columns.pose] = pose.ravel()
    return moved


def _replaced(
    pose: Float[np.ndarray, "K 3"], limb: Int[np.ndarray, " j"], bent: Float[np.ndarray, "j 3"]
) -> Float[np.ndarray, "K 3"]:
    moved = pose.copy()
    moved[limb] = bent
    return moved


def _turned_at_the_base(
    known: Float[np.ndarray, "n j 3"], promising: list[Float[np.ndarray, "j 3"]]
) -> Iterator[Float[np.ndarray, "j 3"]]:
    """Bends of a limb with its first joint turned a little about the two axes that it turns about most."""
    first = known[:, 0] - known[:, 0].mean(0)
    axes = np.linalg.svd(first, full_matrices=False)[2][:2]
    for bent in promising:
        for axis in axes:
            for turn in (-_TURN, _TURN):
                moved = bent.copy()
                moved[0] = moved[0] + turn * axis
                yield moved


def limbs_of(model: SurfaceModel) -> list[Int[np.ndarray, " n"]]:
    """Joints of every branch at the root."""
    parents = np.asarray(model.parents)
    branch = np.arange(len(parents))
    for joint in range(1, len(parents)):
        if parents[joint] > 0:
            branch[joint] = branch[parents[joint]]
    return [np.flatnonzero(branch == head) for head in range(1, len(parents)) if parents[head] == 0]


def known_poses(model: SurfaceModel) -> list[Float[np.ndarray, "K 3"]]:
    """Start poses and the means of the pose mixture, root unrotated.

    The components' longest axes, 1.5 deviations either way, were tried too: three times the work, and no
    fit more was mended.
    """
    poses = start_poses(model)
    for block in model.pose_blocks:
        if block.mixture is None:
            continue
        for mean in block.mixture.means:
            pose = np.zeros((model.joint_count, 3))
            pose[list(block.joints)] = mean.reshape(-1, 3)
            poses.append(pose)
    return poses
