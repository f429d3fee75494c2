"""Row by row, what docs/conventions.md says."""

import runpy
from pathlib import Path

import numpy as np
import pytest
import torch

from corporeal.geometry import rotations
from corporeal.geometry.cameras import Pinhole
from corporeal.model.files import open_model
from corporeal.model.mirror import mirror_model
from corporeal.model.pose import FullPose

SYNTHETIC = runpy.run_path(str(Path(__file__).parents[1] / "synthetic.py"))
QUARTER = np.pi / 2


@pytest.fixture
def model(rng):
    return SYNTHETIC["random_model"](rng)


@pytest.fixture(scope="module")
def hand():
    return open_model("hand")


def pose_of(model, **turns):
    """The zero pose but for the named joints."""
    values = torch.zeros(1, model.joint_count, 3, dtype=torch.float64)
    for name, turn in turns.items():
        values[0, model.joint_names.index(name)] = torch.tensor(turn, dtype=torch.float64)
    return FullPose(values)


def rest_joints(model):
    return model.joint_regressor @ model.template


def at_zero(model):
    return model(None, pose_of(model))


def test_frames_are_unturned_at_the_zero_pose(model):
    posed = at_zero(model)
    np.testing.assert_array_equal(posed.T_world_joint[0, :, :3, :3], np.tile(np.eye(3), (5, 1, 1)))
    np.testing.assert_allclose(posed.T_world_joint[0, :, :3, 3], rest_joints(model), atol=1e-15)
    np.testing.assert_allclose(posed.vertices[0], model.template, atol=1e-15)


def test_frames_map_joint_coordinates_to_the_world(model):
    # A quarter turn about z takes x to y: what lay along -x of the joint now lies along -y.
    posed = model(None, pose_of(model, a1=[0, 0, QUARTER]))
    joint, child = model.joint_names.index("a1"), model.joint_names.index("a2")
    bone = rest_joints(model)[child] - rest_joints(model)[joint]
    in_world = posed.T_world_joint[0, joint].numpy() @ np.append(bone, 1)
    np.testing.assert_allclose(in_world[:3], posed.joints[0, child], atol=1e-15)
    turned = np.array([-bone[1], bone[0], bone[2]])
    np.testing.assert_allclose(posed.joints[0, child] - posed.joints[0, joint], turned, atol=1e-15)


def test_a_joint_turns_against_its_parent_and_carries_its_children_only(model):
    first, second = [0.3, -0.2, 0.9], [-0.5, 0.1, 0.4]
    posed = model(None, pose_of(model, a1=first, a2=second))
    matrices = rotations.matrix_from_axis_angle(torch.tensor([first, second], dtype=torch.float64))
    frames = posed.T_world_joint[0, :, :3, :3]
    np.testing.assert_allclose(frames[1], matrices[0], atol=1e-15)
    np.testing.assert_allclose(frames[2], matrices[0] @ matrices[1], atol=1e-15)
    for name in ("right_wrist", "b1", "b2"):
        np.testing.assert_array_equal(frames[model.joint_names.index(name)], np.eye(3))


def test_the_root_turns_about_its_own_rest_joint(model):
    posed = model(None, pose_of(model, right_wrist=[0.4, 1.2, -0.7]))
    root = rest_joints(model)[0]
    assert np.linalg.norm(root) > 0.7
    np.testing.assert_allclose(posed.joints[0, 0], root, atol=1e-15)
    R = posed.T_world_joint[0, 0, :3, :3].numpy()
    np.testing.assert_allclose(posed.vertices[0], (model.template - root) @ R.T + root, atol=1e-14)


def test_a_translation_is_added_last(model):
    pose, translation = pose_of(model, right_wrist=[0.4, 1.2, -0.7]), torch.tensor([[1.0, 2, 3]]).double()
    np.testing.assert_allclose(
        model(None, pose, None, translation).vertices, model(None, pose).vertices + translation, atol=1e-14
    )


def test_pose_features_are_matrix_elements_row_by_row_minus_the_identity(model):
    # Only one direction is left: element (0, 2) of joint 3 moves vertex 7 along y.
    directions = np.zeros_like(model.pose_directions)
    directions[7, 1, 9 * (3 - 1) + 2] = 1.0
    weights = np.zeros_like(model.skinning_weights)
    weights[:, 0] = 1
    single = model.replace(pose_directions=directions, skinning_weights=weights)
    turn = torch.tensor([0.3, 0.5, -0.2], dtype=torch.float64)
    moved = single(None, pose_of(single, b1=turn.tolist())).vertices[0].numpy() - model.template
    wanted = np.zeros_like(moved)
    wanted[7, 1] = rotations.matrix_from_axis_angle(turn)[0, 2]
    np.testing.assert_allclose(moved, wanted, atol=1e-15)


def test_quaternions_begin_with_their_real_part():
    half = np.sqrt(0.5)
    matrix = rotations.matrix_from_quaternion(torch.tensor([half, 0, 0, half]).double())
    np.testing.assert_allclose(matrix, [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-15)


def test_six_numbers_are_two_columns(rng):
    matrix = rotations.matrix_from_axis_angle(torch.tensor(rng.standard_normal(3)))
    six = rotations.sixd_from_matrix(matrix)
    np.testing.assert_array_equal(six, torch.cat([matrix[:, 0], matrix[:, 1]]))


def test_cameras_look_along_z_with_y_down():
    camera = Pinhole.look_at(np.array([0, 0, 2.0]), np.zeros(3), np.array([0, 1.0, 0]), 0.5, (200, 100))
    pixels, depth = camera.project(np.array([[0, 0, 0.0], [0, 0.1, 0], [0.1, 0, 0]]))
    np.testing.assert_allclose(depth, 2.0)
    np.testing.assert_allclose(pixels[0], [100, 50], atol=1e-12)
    assert pixels[1, 1] < 50 - 1
    assert pixels[2, 0] > 100 + 1


def signed_volume(model):
    a, b, c = (model.template - rest_joints(model)[0])[model.faces].transpose(1, 0, 2)
    return np.einsum("ij,ij->", a, np.cross(b, c)) / 6


@pytest.mark.parametrize("side", ["right", "left"])
def test_the_open_hand_at_zero_pose(hand, side):
    model = hand if side == "right" else mirror_model(hand)
    outward = -1.0 if side == "right" else 1.0
    joints = dict(zip(model.joint_names, rest_joints(model), strict=True))
    for finger in ("index", "middle", "ring", "little"):
        direction = joints[f"{finger}3"] - joints[f"{finger}1"]
        assert outward * direction[0] > 0.85 * np.linalg.norm(direction), finger
    assert joints["index1"][2] > joints["middle1"][2] > joints["ring1"][2] > joints["little1"][2]
    assert joints["thumb3"][2] > joints["index3"][2]
    assert signed_volume(model) > 1e-4
    assert model.side == side
    assert model.joint_names[0] == "wrist"
    assert [name[:-1] for name in model.joint_names[1::3]] == ["index", "middle", "little", "ring", "thumb"]


def test_fingers_of_the_open_hand_curl_towards_the_palm_about_plus_z(hand):
    # Fingers along -x: a positive turn about z takes -x to -y, which is where the palm looks.
    tips = at_zero(hand).joints[0].numpy()
    curled = hand(None, pose_of(hand, index1=[0, 0, 1.0])).joints[0].numpy()
    end = hand.joint_names.index("index3")
    assert curled[end, 1] < tips[end, 1] - 0.02


def test_the_left_hand_is_the_mirror_image_at_x_0(hand):
    left = mirror_model(hand)
    np.testing.assert_array_equal(left.template, hand.template * [-1, 1, 1])
    np.testing.assert_array_equal(left.faces[:, [0, 2, 1]], hand.faces)
