"""The protocol's poses and their performances."""

import numpy as np
import pytest

from corporeal.scans.simulation.files import load_simulator, recorded_angles
from corporeal.scans.simulation.protocol import natural_pose, performed, protocol_poses, subset_for
from corporeal.scans.simulation.skeleton import turns


def test_there_are_fifty_one_poses_and_thirty_one_are_grasps():
    poses = protocol_poses()
    assert len({pose.name for pose in poses}) == 51
    assert sum(pose.group == "grasp" for pose in poses) == 31
    assert [pose.name[:3] for pose in poses] == [f"p{number:02d}" for number in range(1, 52)]


def test_no_two_poses_are_one():
    angles = np.array([pose.angles for pose in protocol_poses()])
    apart = np.abs(angles[:, None] - angles[None]).max((2, 3))
    assert apart[~np.eye(51, dtype=bool)].min() > 7.0


def test_the_first_pose_is_flat():
    assert not np.delete(protocol_poses()[0].angles, 14, axis=0)[:14].any()


def test_every_joint_is_explored():
    angles = np.array([pose.angles for pose in protocol_poses()])
    reach = np.ptp(angles[:, 2:, 0], axis=0)
    assert reach[:12].min() > 35
    assert reach[12:].min() > 35
    assert np.ptp(angles[:, [2, 8, 11, 14], 1], axis=0).min() > 10


def test_poses_cannot_be_changed_by_a_caller():
    with pytest.raises(ValueError, match="read-only"):
        protocol_poses()[0].angles[:] = 1


@pytest.mark.parametrize("index", range(0, 51, 7))
def test_performances_differ_by_degrees_and_stay_within_limits(index):
    pose = protocol_poses()[index]
    generator = np.random.default_rng(index)
    performances = np.array([performed(pose, generator).angles for _ in range(60)])
    spread = performances[:, 2:, 0].std(0)
    assert 0.5 < np.median(spread) < 9
    assert np.abs(performances[:, 2:, 1:]).max() <= 50
    curl = performances[:, 2:14, 0].reshape(60, 4, 3).sum(2)
    assert curl.max() < 206
    assert not performances[:, 0].any()


def test_the_intended_poses_are_within_the_limits():
    """Many performances surround the pose: what is meant is not what the limits left of it."""
    for pose in protocol_poses():
        generator = np.random.default_rng(1)
        mean = np.mean([performed(pose, generator).angles for _ in range(80)], axis=0)
        np.testing.assert_allclose(mean, pose.angles, atol=4.0, err_msg=pose.name)


def test_recorded_angles_name_rotations_once():
    """No triple is near the singular spread, and small changes of a rotation are small changes of angles."""
    angles = recorded_angles()
    assert angles.shape == (400, 15, 3)
    assert np.abs(angles[:, :, 1]).max() < 35
    simulator = load_simulator()
    whole = np.zeros((17, 3))
    whole[2:] = angles[7]
    moved = whole.copy()
    moved[2:] += 0.5
    change = turns(moved, simulator.axes) @ turns(whole, simulator.axes).transpose(0, 2, 1)
    cosine = (np.trace(change, axis1=1, axis2=2) - 1) / 2
    assert np.rad2deg(np.arccos(np.clip(cosine, -1, 1))).max() < 1.6


def test_natural_poses_are_hardly_limited():
    recorded = recorded_angles()
    generator = np.random.default_rng(5)
    for _ in range(20):
        pose = natural_pose(generator).angles[2:]
        nearest = np.abs(recorded - pose).mean((1, 2)).min()
        assert nearest < 8


def test_a_subset_keeps_the_flat_pose_and_draws_the_others():
    draws = [subset_for(51, np.random.default_rng(seed)) for seed in range(30)]
    assert {len(draw) for draw in draws} == {32}
    assert all(draw[0] == 0 and list(draw) == sorted(set(draw)) for draw in draws)
    assert set().union(*draws) == set(range(51))
