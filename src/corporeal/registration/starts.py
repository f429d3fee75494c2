"""Where a fit begins: rigid alignment to landmarks, or orientations tried in turn where there are none."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from corporeal.model.jacobian import evaluate
from corporeal.model.landmarks import LandmarkSet
from corporeal.model.surface_model import SurfaceModel


def similarity(
    source: Float[np.ndarray, "N 3"],
    target: Float[np.ndarray, "N 3"],
    weights: Float[np.ndarray, " N"],
) -> tuple[float, Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]]:
    """Scale, rotation and translation that take source to target (Umeyama 1991), weighted."""
    share = weights / weights.sum()
    source_mean, target_mean = share @ source, share @ target
    a, b = source - source_mean, target - target_mean
    u, s, vt = np.linalg.svd((share[:, None] * b).T @ a)
    flip = np.array([1, 1, np.sign(np.linalg.det(u @ vt))])
    R = (u * flip) @ vt
    scale = float((s * flip).sum() / (share @ (a * a).sum(1)))
    return scale, R, target_mean - scale * R @ source_mean


def landmark_start(
    model: SurfaceModel,
    landmark_set: LandmarkSet,
    positions: Float[np.ndarray, "N 3"],
    weights: Float[np.ndarray, " N"],
    pose: Float[np.ndarray, "K 3"],
    shape_count: int,
) -> tuple[Float[np.ndarray, " Q"], float]:
    """Parameter vector of a pose laid onto landmarks, and the scale that the landmarks suggest.

    The scale is scan over model: 1 for a scan in true metres of a hand as large as the template.
    """
    shape = np.zeros(shape_count)
    posed = evaluate(model, shape, pose, np.zeros(3))
    source = landmark_set.positions(posed.vertices, posed.joints)
    scale, R, _ = similarity(source, positions, weights)
    share = weights / weights.sum()
    shift = share @ positions - R @ (share @ source)
    return turned(model, pose, shape, R, shift), scale


def turned(
    model: SurfaceModel,
    pose: Float[np.ndarray, "K 3"],
    shape: Float[np.ndarray, " s"],
    R: Float[np.ndarray, "3 3"],
    t: Float[np.ndarray, "3"],
) -> Float[np.ndarray, " Q"]:
    """Parameter vector of the surface moved by x -> R x + t; the root turns about its own rest joint."""
    root = evaluate(model, shape, pose, np.zeros(3)).joints[0]
    moved = pose.copy()
    moved[0] = Rotation.from_matrix(R @ Rotation.from_rotvec(pose[0]).as_matrix()).as_rotvec()
    return np.concatenate([R @ root + t - root, moved.ravel(), shape])


def start_poses(model: SurfaceModel) -> list[Float[np.ndarray, "K 3"]]:
    """Poses to begin from: flat, as hands are shown to a scanner, to the mean of the recordings."""
    mean = mean_pose(model)
    return [np.zeros_like(mean), 0.5 * mean, mean]


def mean_pose(model: SurfaceModel) -> Float[np.ndarray, "K 3"]:
    """The mean of every pose block, root unrotated."""
    pose = np.zeros((model.joint_count, 3))
    for block in model.pose_blocks:
        pose[list(block.joints)] = block.mean.reshape(-1, 3)
    return pose


def average_scale(
    model: SurfaceModel, vector: Float[np.ndarray, " Q"], pose: Float[np.ndarray, "K 3"]
) -> tuple[float, Float[np.ndarray, " Q"]]:
    """How much larger the fitted hand is than the average one, and the average one in its place.

    For scans without a unit: the most likely scale under the shape prior is the one at which the hand has the
    average size. Returned are the factor that the scan has to be divided by, and the parameters that fit the
    divided scan: the same pose, the average shape, placed on the fitted hand.
    """
    size = 3 + pose.size
    translation, shape = vector[:3], vector[size:]
    fitted = evaluate(model, shape, pose, translation).vertices
    average = evaluate(model, np.zeros_like(shape), pose, np.zeros(3)).vertices
    spread = np.linalg.norm(fitted - fitted.mean(0)), np.linalg.norm(average - average.mean(0))
    factor = float(spread[0] / spread[1])
    moved = vector.copy()
    moved[:3] = fitted.mean(0) / factor - average.mean(0)
    moved[size:] = 0
    return factor, moved
