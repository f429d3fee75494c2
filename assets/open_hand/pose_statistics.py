"""Mean, principal components, mixture and anatomical limits of the hand's 45 pose numbers."""

from __future__ import annotations

import numpy as np

from corporeal.model.statistics import PoseBlock, PoseMixture

from .rig import FINGERS

# Flexion, spread and twist of the finger joints in degrees: usual clinical ranges, rounded outward.
_LIMITS_DEG = (
    ((-30, 100), (-25, 25), (-20, 20)),
    ((-10, 115), (-6, 6), (-8, 8)),
    ((-15, 90), (-5, 5), (-5, 5)),
)
_THUMB_MARGIN = np.deg2rad(15)
_FLOOR = np.deg2rad(2.0)


def pose_block(poses: np.ndarray, joints: np.ndarray, seed: int) -> PoseBlock:
    """The block "hand" from (N, 45) axis-angle poses in radians."""
    mean = poses.mean(0)
    _, s, vt = np.linalg.svd(poses - mean, full_matrices=False)
    vt = vt * np.sign(vt[np.arange(len(vt)), np.abs(vt).argmax(1)])[:, None]
    deviations = s / np.sqrt(len(poses) - 1)
    return PoseBlock(
        name="hand",
        joints=tuple(range(1, 16)),
        mean=mean,
        components=vt,
        component_deviations=deviations,
        mean_included=True,
        mixture=_mixture(poses, seed),
        limits=_limits(poses, joints),
    )


def _mixture(poses: np.ndarray, seed: int) -> PoseMixture:
    from sklearn.mixture import GaussianMixture

    # A hand that is held flat was hardly recorded, but is what people show a scanner: the zero pose and its
    # neighbourhood get a component's worth of samples.
    generator = np.random.default_rng(seed)
    flat = 0.08 * generator.normal(size=(len(poses) // 10, poses.shape[1]))
    fitted = GaussianMixture(10, reg_covar=_FLOOR**2, random_state=seed, n_init=2).fit(
        np.concatenate([poses, flat])
    )
    return PoseMixture(fitted.weights_, fitted.means_, fitted.covariances_)


def _limits(poses: np.ndarray, joints: np.ndarray) -> np.ndarray:
    limits = np.zeros((15, 3, 2))
    up = np.array([0.0, 1, 0])
    for f, finger in enumerate(FINGERS):
        if finger == "thumb":
            continue
        bone = joints[3 * f + 2] - joints[3 * f + 1]
        bone = bone / np.linalg.norm(bone)
        axes = np.stack([np.cross(up, bone), up, bone])
        for k, ranges in enumerate(_LIMITS_DEG):
            corners = np.array(np.meshgrid(*np.deg2rad(ranges))).reshape(3, -1).T @ axes
            limits[3 * f + k] = np.stack([corners.min(0), corners.max(0)], axis=1)
    thumb = poses.reshape(-1, 15, 3)[:, 12:]
    low, high = np.quantile(thumb, [0.005, 0.995], axis=0)
    limits[12:] = np.stack([np.minimum(low, 0) - _THUMB_MARGIN, np.maximum(high, 0) + _THUMB_MARGIN], axis=-1)
    return limits.reshape(45, 2)
