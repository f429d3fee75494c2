"""Statistics of the body's 63 pose numbers from recorded motion: mixture and limits.

Three people were recorded. What they did is widened by what joints can do: every number varies by a share of
its anatomical range beside what was recorded, left and right are the same, and the stances that people take
for a scanner are counted in.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from corporeal.model.statistics import PoseBlock, PoseMixture

from .recorded_motion import JOINTS, Clip

COMPONENTS = 8
# Share of a number's anatomical range that is added as a standard deviation: of 0, 2, 4, ... 16 % the one
# with which two subjects' poses predict the third's best (``add_body_poses.py --choose`` prints the table).
WIDENED = 0.12
_LIKE = np.deg2rad(6.0)
_EVERY = 6
# T-pose, A-pose and hanging arms: the shoulders' turn about z, degrees.
_STANCES = (0.0, 25.0, 45.0, 75.0)
_STANCE_SHARE = 0.1
# Recorded poses beyond a limit widen it, save for the outermost.
_OUTERMOST = 0.002
_MARGIN = np.deg2rad(3.0)


def body_poses(clips: list[Clip], seed: int) -> np.ndarray:
    """(N, 63) different poses (no two nearer than 6 degrees, root mean square) and mirrored ones."""
    poses = np.concatenate([clip.pose[::_EVERY, 1:].reshape(-1, 63) for clip in clips])
    poses = poses[np.random.default_rng(seed).permutation(len(poses))]
    kept = np.empty_like(poses)
    count = 0
    for pose in poses:
        if not count or np.sqrt(np.mean((kept[:count] - pose) ** 2, axis=1)).min() > _LIKE:
            kept[count] = pose
            count += 1
    return np.concatenate([kept[:count], mirrored_poses(kept[:count])])


def mirrored_poses(poses: np.ndarray) -> np.ndarray:
    """(N, 63) of the mirror image."""
    swap = {"left": "right", "right": "left"}
    parts = [name.partition("_") for name in JOINTS[1:]]
    other = [JOINTS[1:].index(f"{swap[a]}_{c}" if a in swap else a) for a, _, c in parts]
    return (poses.reshape(-1, 21, 3)[:, other] * [1, -1, -1]).reshape(len(poses), 63)


def widened_limits(limits: np.ndarray, poses: np.ndarray) -> np.ndarray:
    """(63, 2) limits that hold the recorded poses too: ranges about one axis say little of two at once."""
    low, high = np.quantile(poses, [_OUTERMOST, 1 - _OUTERMOST], axis=0)
    return np.stack(
        [np.minimum(limits[:, 0], low - _MARGIN), np.maximum(limits[:, 1], high + _MARGIN)], axis=1
    )


def block_with_statistics(
    block: PoseBlock, poses: np.ndarray, seed: int, widened: float = WIDENED
) -> PoseBlock:
    """The block "body" with what ``poses`` (N, 63) say; its limits are anatomical ranges.

    The block keeps its mean, the T-pose, and no components: a body is not followed in a few of them.
    """
    limits = np.asarray(block.limits)
    spread = widened * np.ptp(limits, axis=1)
    return dataclasses.replace(
        block, mixture=_mixture(poses, spread, seed), limits=widened_limits(limits, poses)
    )


def _mixture(poses: np.ndarray, spread: np.ndarray, seed: int) -> PoseMixture:
    from sklearn.mixture import GaussianMixture

    generator = np.random.default_rng(seed)
    stances = np.zeros((int(_STANCE_SHARE * len(poses)), 21, 3))
    angles = np.deg2rad(generator.choice(_STANCES, size=len(stances)))
    shoulders = [JOINTS.index(f"{side}_shoulder") - 1 for side in ("left", "right")]
    stances[:, shoulders, 2] = angles[:, None] * [-1, 1]
    samples = np.concatenate([poses, stances.reshape(-1, 63)])
    # Fitted with the widening as noise, not only afterwards: the components divide what is left apart by it.
    samples = samples + spread * generator.normal(size=samples.shape)
    fitted = GaussianMixture(COMPONENTS, reg_covar=1e-3, random_state=seed, n_init=3).fit(samples)
    return PoseMixture(fitted.weights_, fitted.means_, fitted.covariances_)


def log_likelihood(mixture: PoseMixture, poses: np.ndarray) -> np.ndarray:
    """(N,) of every pose under the mixture."""
    from scipy.special import logsumexp

    differences = poses[:, None] - mixture.means
    solved = np.linalg.solve(mixture.covariances, differences.transpose(1, 2, 0)).transpose(2, 0, 1)
    _, determinants = np.linalg.slogdet(2 * np.pi * mixture.covariances)
    distances = np.einsum("nmd,nmd->nm", differences, solved)
    return logsumexp(np.log(mixture.weights) - 0.5 * (distances + determinants), axis=1)
