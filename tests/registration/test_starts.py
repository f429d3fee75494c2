"""Where a fit begins: similarity alignment, landmarks laid onto, turning about the root."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from corporeal.model.jacobian import evaluate
from corporeal.registration.starts import landmark_start, similarity, start_poses, turned


def test_a_similarity_is_recovered_even_if_it_would_rather_be_a_reflection(rng):
    source = rng.standard_normal((9, 3))
    R, t = Rotation.random(random_state=3).as_matrix(), rng.standard_normal(3)
    scale, found_R, found_t = similarity(source, 1.7 * source @ R.T + t, np.ones(9))
    assert scale == pytest.approx(1.7)
    np.testing.assert_allclose(found_R, R, atol=1e-12)
    np.testing.assert_allclose(found_t, t, atol=1e-12)
    _, mirrored, _ = similarity(source, source * [-1, 1, 1], np.ones(9))
    assert np.linalg.det(mirrored) == pytest.approx(1.0)


def test_weights_leave_an_outlier_aside(rng):
    source = rng.standard_normal((8, 3))
    R = Rotation.random(random_state=4).as_matrix()
    target = source @ R.T
    target[2] += 5.0
    weights = np.ones(8)
    weights[2] = 0.0
    np.testing.assert_allclose(similarity(source, target, weights)[1], R, atol=1e-12)


def test_turned_moves_the_surface_rigidly_whatever_the_shape(hand, rng):
    pose = 0.4 * rng.standard_normal((hand.joint_count, 3))
    shape = rng.standard_normal(hand.shape_count)
    R, t = Rotation.random(random_state=5).as_matrix(), rng.standard_normal(3)
    vector = turned(hand, pose, shape, R, t)
    size = 3 + pose.size
    moved = evaluate(hand, vector[size:], vector[3:size].reshape(-1, 3), vector[:3])
    still = evaluate(hand, shape, pose, np.zeros(3))
    np.testing.assert_allclose(moved.vertices, still.vertices @ R.T + t, atol=1e-9)
    np.testing.assert_array_equal(vector[size:], shape)


def test_a_pose_is_laid_onto_its_own_landmarks_and_the_scale_is_found(hand):
    landmark_set = hand.landmarks["hand_21_mediapipe"]
    R, t = Rotation.random(random_state=6).as_matrix(), np.array([0.2, -0.4, 0.1])
    count = len(landmark_set.names)
    for pose in start_poses(hand):
        posed = evaluate(hand, np.zeros(5), pose, np.zeros(3))
        marks = landmark_set.positions(posed.vertices, posed.joints)
        for size in (1.0, 20.8):
            vector, scale = landmark_start(
                hand, landmark_set, size * marks @ R.T + t, np.ones(count), pose, shape_count=5
            )
            assert scale == pytest.approx(size)
            laid = evaluate(hand, vector[-5:], vector[3:-5].reshape(-1, 3), vector[:3])
            found = landmark_set.positions(laid.vertices, laid.joints)
            # In the model's metres, about the middle: the scan is brought to the scale afterwards.
            expected = marks @ R.T
            np.testing.assert_allclose(found - found.mean(0), expected - expected.mean(0), atol=1e-9)
            if size == 1.0:
                np.testing.assert_allclose(found, expected + t, atol=1e-9)


def test_start_poses_differ_and_leave_the_root_unturned(hand):
    poses = start_poses(hand)
    assert len(poses) >= 2
    for number, pose in enumerate(poses):
        np.testing.assert_array_equal(pose[0], 0)
        for other in poses[:number]:
            assert np.abs(pose - other).max() > 0.1
