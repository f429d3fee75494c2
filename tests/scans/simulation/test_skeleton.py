"""Bones turn as anatomy says, about the axes of the flat hand."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from corporeal.scans.simulation.files import HandSimulator, load_simulator
from corporeal.scans.simulation.skeleton import angles_of_turns, bone_transforms, turns

FLEXION, SPREAD, TWIST = range(3)
ENDS = np.array([3, 4, 17, 6, 7, 18, 9, 10, 19, 12, 13, 20, 15, 16, 21])


@pytest.fixture(scope="module")
def simulator() -> HandSimulator:
    return load_simulator()


def _posed(simulator: HandSimulator, angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Heads (17, 3) and ends of the finger bones (15, 3) in the pose."""
    motions = bone_transforms(simulator, simulator.joints, angles)
    heads = np.einsum("bij,bj->bi", motions[:, :3, :3], simulator.joints[:17]) + motions[:, :3, 3]
    ends = np.einsum("bij,bj->bi", motions[2:, :3, :3], simulator.joints[ENDS]) + motions[2:, :3, 3]
    return heads, ends


def test_the_rest_angles_are_the_rest_pose(simulator):
    motions = bone_transforms(simulator, simulator.joints, simulator.rest_angles)
    np.testing.assert_allclose(motions, np.tile(np.eye(4), (17, 1, 1)), atol=1e-12)


def test_angles_come_back_from_their_turns(simulator, rng):
    angles = rng.uniform(-1, 1, (17, 3)) * [110.0, 60.0, 50.0]
    np.testing.assert_allclose(
        angles_of_turns(turns(angles, simulator.axes), simulator.axes), angles, atol=1e-9
    )


def test_motions_are_rigid_and_keep_the_joints_together(simulator, rng):
    angles = rng.uniform(-60, 60, (17, 3))
    angles[0] = 0
    motions = bone_transforms(simulator, simulator.joints, angles)
    R = motions[:, :3, :3]
    np.testing.assert_allclose(R @ R.transpose(0, 2, 1), np.tile(np.eye(3), (17, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(R), 1)
    np.testing.assert_allclose(motions[0], np.eye(4), atol=1e-12)
    for bone in range(1, 17):
        head = np.append(simulator.joints[bone], 1)
        np.testing.assert_allclose(motions[bone] @ head, motions[simulator.parents[bone]] @ head, atol=1e-12)


def test_angles_are_turns_in_the_axes_of_the_flat_hand(simulator, rng):
    """R = Rot(f, flexion) Rot(n, spread) Rot(d, twist) of every bone against its parent, both seen flat."""
    flat = bone_transforms(simulator, simulator.joints, np.zeros((17, 3)))[:, :3, :3]
    flat_axes = np.einsum("bij,bkj->bki", flat, simulator.axes)
    angles = rng.uniform(-50, 50, (17, 3))
    angles[0] = 0
    turned = bone_transforms(simulator, simulator.joints, angles)[:, :3, :3] @ flat.transpose(0, 2, 1)
    for bone in range(1, 17):
        own = turned[simulator.parents[bone]].T @ turned[bone]
        f, n, d = flat_axes[bone]
        flexion, spread, twist = np.deg2rad(angles[bone])
        expected = Rotation.from_rotvec(flexion * f) * Rotation.from_rotvec(spread * n)
        expected = expected * Rotation.from_rotvec(twist * d)
        np.testing.assert_allclose(own, expected.as_matrix(), atol=1e-12)


def test_the_skeleton_turns_with_its_frame(simulator, rng):
    """A hand that lies elsewhere and otherwise moves in the same way there."""
    from dataclasses import replace

    R = Rotation.random(random_state=7).as_matrix()
    t = rng.normal(size=3)
    angles = rng.uniform(-40, 40, (17, 3))
    angles[0] = 0
    here = bone_transforms(simulator, simulator.joints, angles)
    elsewhere = replace(simulator, axes=simulator.axes @ R.T)
    there = bone_transforms(elsewhere, simulator.joints @ R.T + t, angles)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, t
    np.testing.assert_allclose(there, T @ here @ np.linalg.inv(T), atol=1e-12)


def test_the_flat_hand_is_the_open_hands_zero_pose(simulator):
    from importlib.resources import files

    packed = files("corporeal") / "model" / "open_models" / "start_hand.npz"
    with packed.open("rb") as stream, np.load(stream) as model:
        joints = model["J_regressor"] @ model["v_template"]
    heads, ends = _posed(simulator, np.zeros((17, 3)))
    bones = (ends - heads[2:]).reshape(5, 3, 3)
    for finger in range(5):
        for k in range(2):
            own = bones[finger, k] / np.linalg.norm(bones[finger, k])
            other = joints[3 * finger + k + 2] - joints[3 * finger + k + 1]
            angle = np.rad2deg(np.arccos(own @ other / np.linalg.norm(other)))
            assert angle < (16 if finger == 4 and k == 0 else 8), (finger, k, angle)


@pytest.mark.parametrize("finger", range(5))
def test_flexion_goes_to_the_palm_and_spread_to_the_thumb(simulator, finger):
    first = 2 + 3 * finger
    _, flat = _posed(simulator, np.zeros((17, 3)))
    angles = np.zeros((17, 3))
    angles[first, FLEXION] = 30
    _, bent = _posed(simulator, angles)
    angles[first] = [0, 20, 0]
    _, spread = _posed(simulator, angles)
    tip = 3 * finger + 2
    if finger < 4:
        assert bent[tip, 1] - flat[tip, 1] < -0.015
        assert spread[tip, 2] - flat[tip, 2] > 0.015
    else:
        # The thumb bends across the palm, towards the little finger, and spreads away from the fingers.
        assert bent[tip, 2] - flat[tip, 2] < -0.015
        assert spread[tip, 2] - flat[tip, 2] > 0.005
