"""Rigid bones: anatomical angles to motions."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from corporeal.scans.simulation.files import HandSimulator


def turns(
    angles: Float[np.ndarray, "17 3"], axes: Float[np.ndarray, "17 3 3"]
) -> Float[np.ndarray, "17 3 3"]:
    """Rotation of every bone from its angles: twist first, then spread, then flexion.

    In this order no triple is singular short of a spread of 90 degrees; with spread last, a knuckle bent by
    90 degrees had no angles of its own.

    Args:
        angles: degrees.
        axes: rows: flexion, spread and twist axis.
    """
    flexion, spread, twist = (
        Rotation.from_rotvec(np.deg2rad(angles[:, k, None]) * axes[:, k]) for k in range(3)
    )
    return (flexion * spread * twist).as_matrix()


def angles_of_turns(
    rotations: Float[np.ndarray, "17 3 3"], axes: Float[np.ndarray, "17 3 3"]
) -> Float[np.ndarray, "17 3"]:
    """Degrees of flexion, spread and twist: the inverse of ``turns`` for spreads within 90 degrees."""
    in_own_axes = np.einsum("kab,kbc,kdc->kad", axes, rotations, axes)
    return Rotation.from_matrix(in_own_axes).as_euler("XYZ", degrees=True)


def bone_transforms(
    simulator: HandSimulator, joints: Float[np.ndarray, "22 3"], angles: Float[np.ndarray, "17 3"]
) -> Float[np.ndarray, "17 4 4"]:
    """Motion of every bone from rest to the pose, chained down the tree, metres.

    Args:
        simulator: axes, parents and the rest pose's own angles.
        joints: heads of the person's bones at rest, metres.
        angles: degrees against the flat hand; the rest pose's own are taken off.
    """
    rest = turns(simulator.rest_angles, simulator.axes)
    # The axes are those at rest, carried there by the rest pose's own turn: it is taken off first, not last.
    own = rest.transpose(0, 2, 1) @ turns(angles, simulator.axes)
    motions = np.tile(np.eye(4), (17, 1, 1))
    for bone in range(17):
        head = joints[bone]
        motions[bone, :3, :3] = own[bone]
        motions[bone, :3, 3] = head - own[bone] @ head
        if simulator.parents[bone] >= 0:
            motions[bone] = motions[simulator.parents[bone]] @ motions[bone]
    return motions
