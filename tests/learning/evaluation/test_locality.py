"""Shares of energy that are known, and the weighting against displacements that are counted."""

import numpy as np
import pytest

from corporeal.geometry.rotations_numeric import matrix_from_axis_angle
from corporeal.learning.evaluation.locality import feature_moments, locality

NAMES = ("root", "a", "b")


def directions_of(rng, near, far):
    """Two vertices near and two far from joint "a"; joint "b" has none."""
    directions = np.zeros((4, 3, 18))
    directions[:, :, :9] = rng.normal(size=(4, 3, 9))
    energy = (directions**2).sum(axis=(1, 2))
    directions *= np.sqrt(np.array([near, near, far, far]) / energy)[:, None, None]
    return directions


DISTANCES = np.array([[0.0, 0.0, 0.0, 0.0], [0.01, 0.03, 0.05, 0.09], [0.09, 0.09, 0.09, 0.09]])


def test_the_share_is_that_of_far_vertices(rng):
    found = locality("m", directions_of(rng, 3.0, 1.0), DISTANCES, NAMES)
    assert found.share == pytest.approx(0.25)
    assert [(joint.joint, joint.share) for joint in found.by_joint] == [
        ("a", pytest.approx(0.25)),
        ("b", 0.0),
    ]
    assert locality("m", directions_of(rng, 3.0, 1.0), DISTANCES, NAMES, far=0.06).share == pytest.approx(
        0.125
    )
    assert (found.weighting, found.distance_mm) == ("plain", 40.0)


def test_weighted_energy_is_the_mean_squared_displacement_over_the_poses(rng):
    poses = 0.6 * rng.normal(size=(25, 3, 3))
    directions = rng.normal(size=(4, 3, 18))
    squared = np.zeros((2, 4))
    for pose in poses:
        features = (matrix_from_axis_angle(pose[1:]) - np.eye(3)).reshape(2, 9)
        for joint in range(2):
            moved = directions[:, :, 9 * joint : 9 * joint + 9] @ features[joint]
            squared[joint] += (moved**2).sum(axis=1) / len(poses)
    far = (DISTANCES[1:] > 0.04) * squared
    found = locality("m", directions, DISTANCES, NAMES, moments=feature_moments(poses))
    assert found.share == pytest.approx(far.sum() / squared.sum())
    assert found.by_joint[0].share == pytest.approx(far[0].sum() / squared[0].sum())
    assert found.weighting == "training poses"


def test_a_joint_that_never_moves_has_no_weight(rng):
    poses = rng.normal(size=(9, 3, 3))
    poses[:, 2] = 0
    directions = np.concatenate([directions_of(rng, 1.0, 0.0)[:, :, :9], rng.normal(size=(4, 3, 9))], axis=2)
    assert locality("m", directions, DISTANCES, NAMES, moments=feature_moments(poses)).share == 0
    assert locality("m", directions, DISTANCES, NAMES).share > 0.5


def test_shapes_that_do_not_match_and_no_correctives_are_refused(rng):
    with pytest.raises(ValueError, match="expected"):
        locality("m", rng.normal(size=(4, 3, 18)), DISTANCES[:2], NAMES)
    with pytest.raises(ValueError, match="no correctives"):
        locality("m", np.zeros((4, 3, 18)), DISTANCES, NAMES)
