"""Distances to bones, and the hinges between them."""

import numpy as np
from scipy.spatial.transform import Rotation

from corporeal.scans.simulation.bone_rods import hinge_motions, to_segment


def test_distance_to_a_segment_is_that_to_its_ends_beyond_them(rng):
    head, end = np.array([0.0, 0, 0]), np.array([2.0, 0, 0])
    points = np.array([[1.0, 3, 4], [-3.0, 4, 0], [4.0, 0, 0]])
    distance, along = to_segment(points, head, end)
    np.testing.assert_allclose(distance, [5, 5, 2])
    np.testing.assert_allclose(along, [0.5, -1.5, 2])


def test_a_hinge_turns_half_as_far_and_stays_in_its_joint(rng):
    joints = rng.normal(size=(3, 3))
    parents = np.array([-1, 0, 1])
    motions = np.tile(np.eye(4), (3, 1, 1))
    turns = [Rotation.from_rotvec(0.8 * rng.normal(size=3)).as_matrix() for _ in range(3)]
    for bone, turn in enumerate(turns):
        own = np.eye(4)
        own[:3, :3], own[:3, 3] = turn, joints[bone] - turn @ joints[bone]
        motions[bone] = own if bone == 0 else motions[parents[bone]] @ own
    halves = hinge_motions(motions, joints, parents, (1, 2))
    for half, bone in zip(halves, (1, 2), strict=True):
        back = np.linalg.inv(motions[parents[bone]]) @ half
        np.testing.assert_allclose(back[:3, :3] @ back[:3, :3], turns[bone], atol=1e-12)
        place = np.append(joints[bone], 1)
        np.testing.assert_allclose(half @ place, motions[bone] @ place, atol=1e-12)
