"""How local learned pose correctives are: the share of their energy far from the joint that drives them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from corporeal.geometry.rotations_numeric import matrix_from_axis_angle
from corporeal.learning.evaluation.results import JointShare, Locality

FAR = 0.04
"""Metres of geodesic distance beyond which a corrective is far: about half a finger's length."""


def locality(
    label: str,
    pose_directions: Float[np.ndarray, "V 3 P"],
    distances: Float[np.ndarray, "K V"],
    joint_names: Sequence[str],
    *,
    moments: Float[np.ndarray, "J 9 9"] | None = None,
    far: float = FAR,
) -> Locality:
    """Share of corrective energy farther than ``far`` from its joint.

    Energy of a joint at a vertex is that of its 3 x 9 block B. Plain: the squared Frobenius norm of B, in
    which all nine elements of the rotation matrix count alike. Weighted: trace(B M B^T) with the joint's
    ``moments`` M, the mean squared displacement that this joint's block alone causes over the training poses;
    what no pose ever does then does not count. Terms between two joints are left out of both: they
    belong to neither.

    Args:
        label: of the model.
        pose_directions: P = 9 (K - 1), metres per unit of the features.
        distances: geodesic, of every joint to every vertex, metres; the root's row is not used.
        joint_names: K names.
        moments: of ``feature_moments`` for J = K - 1 joints, or None for plain.
        far: metres.

    Raises:
        ValueError: shapes that do not match, or no correctives.
    """
    V, K = len(pose_directions), len(distances)
    if pose_directions.shape[2] != 9 * (K - 1) or distances.shape[1] != V or len(joint_names) != K:
        raise ValueError(
            f"pose_directions {pose_directions.shape}, distances {distances.shape}, {len(joint_names)} "
            "joint_names: expected (V, 3, 9 (K - 1)), (K, V) and K"
        )
    blocks = pose_directions.reshape(V, 3, K - 1, 9)
    if moments is None:
        energy = np.einsum("vajp,vajp->jv", blocks, blocks)
    else:
        energy = np.einsum("vajp,jpq,vajq->jv", blocks, moments, blocks, optimize=True)
    own = energy.sum(axis=1)
    if not own.sum() > 0:
        raise ValueError(f"pose_directions: {label!r} has no correctives")
    beyond = np.where(distances[1:] > far, energy, 0.0).sum(axis=1)
    shares = np.divide(beyond, own, out=np.zeros_like(own), where=own > 0)
    return Locality(
        label=label,
        weighting="plain" if moments is None else "training poses",
        distance_mm=1e3 * far,
        share=float(beyond.sum() / own.sum()),
        by_joint=tuple(
            JointShare(name, float(share)) for name, share in zip(joint_names[1:], shares, strict=True)
        ),
    )


def feature_moments(poses: Float[np.ndarray, "N K 3"]) -> Float[np.ndarray, "J 9 9"]:
    """Second moments of the pose features (equation 3) of every joint after the root, J = K - 1.

    About zero and not about the mean: the features vanish at the zero pose, and correctives with them.

    Args:
        poses: axis-angle of the training poses, radians.
    """
    N, K = poses.shape[:2]
    turned = matrix_from_axis_angle(poses[:, 1:].reshape(-1, 3).astype(np.float64)) - np.eye(3)
    features = turned.reshape(N, K - 1, 9)
    return np.einsum("njp,njq->jpq", features, features) / N
