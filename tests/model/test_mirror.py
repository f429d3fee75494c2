import runpy
from pathlib import Path

import numpy as np
import pytest
import torch

from corporeal.geometry import rotations
from corporeal.model.mirror import mirror_model, mirror_pose, mirror_translation, swap_sides
from corporeal.model.pose import CoefficientPose, FullPose

SYNTHETIC = runpy.run_path(str(Path(__file__).parents[1] / "synthetic.py"))
REPRESENTATIONS = {
    "axis_angle": rotations.axis_angle_from_matrix,
    "matrix": lambda matrix: matrix,
    "quaternion": rotations.quaternion_from_matrix,
    "6d": rotations.sixd_from_matrix,
}


@pytest.fixture
def hand(rng):
    return SYNTHETIC["random_model"](rng)


@pytest.fixture
def body(rng):
    return SYNTHETIC["random_body"](rng)


def numbers(rng, *shape):
    return torch.tensor(rng.standard_normal(shape))


def posed_arguments(model, rng, batch=3):
    return {
        "shape": numbers(rng, batch, model.shape_count),
        "expression": numbers(rng, batch, model.expression_count),
        "translation": numbers(rng, batch, 3),
    }


def assert_mirrored(model, pose, arguments):
    """mirror(model)(mirror(pose)) == mirror(model(pose)), with landmarks and joint frames."""
    moved = {**arguments, "translation": mirror_translation(arguments["translation"])}
    plain = model(pose=pose, **arguments)
    mirrored_model = mirror_model(model)
    mirrored = mirrored_model(pose=mirror_pose(pose, model), **moved)
    vertices, joints = plain.vertices.numpy(), plain.joints.numpy()
    diagonal = np.array([-1.0, 1, 1])
    flip = np.diag([-1.0, 1, 1, 1])
    vertex_map = np.arange(model.vertex_count) if model.mirror_vertices is None else model.mirror_vertices
    joint_map = np.arange(model.joint_count) if model.mirror_joints is None else model.mirror_joints
    np.testing.assert_allclose(mirrored.vertices.numpy(), vertices[:, vertex_map] * diagonal, atol=1e-12)
    np.testing.assert_allclose(mirrored.joints.numpy(), joints[:, joint_map] * diagonal, atol=1e-12)
    frames = flip @ plain.T_world_joint.numpy()[:, joint_map] @ flip
    np.testing.assert_allclose(mirrored.T_world_joint.numpy(), frames, atol=1e-12)
    for name, landmarks in model.landmarks.items():
        got = mirrored_model.landmarks[name]
        for index, landmark in enumerate(landmarks.names):
            wanted = landmarks.positions(vertices[0], joints[0])[index] * diagonal
            place = got.names.index(swap_sides(landmark))
            at = got.positions(mirrored.vertices[0].numpy(), mirrored.joints[0].numpy())[place]
            np.testing.assert_allclose(at, wanted, atol=1e-12)


@pytest.mark.parametrize("representation", REPRESENTATIONS)
@pytest.mark.parametrize("kind", ["hand", "body"])
def test_the_mirrored_model_in_the_mirrored_pose_is_the_mirror_image(kind, representation, request, rng):
    model = request.getfixturevalue(kind)
    matrices = rotations.matrix_from_axis_angle(numbers(rng, 3, model.joint_count, 3))
    pose = FullPose(REPRESENTATIONS[representation](matrices), representation)
    assert_mirrored(model, pose, posed_arguments(model, rng))


def test_coefficients_of_a_hand_stay(hand, rng):
    pose = CoefficientPose(
        numbers(rng, 3, 3), {"right_hand": numbers(rng, 3, 2)}, {"end": numbers(rng, 3, 1, 3)}
    )
    mirrored = mirror_pose(pose)
    assert mirrored.coefficients["left_hand"] is pose.coefficients["right_hand"]
    assert_mirrored(hand, pose, posed_arguments(hand, rng))


def test_coefficients_of_a_body_change_sides(body, rng):
    pose = CoefficientPose(
        numbers(rng, 3, 3),
        {"left_hand": numbers(rng, 3, 2), "right_hand": numbers(rng, 3, 3)},
        {"body": numbers(rng, 3, 2, 3)},
    )
    mirrored = mirror_pose(pose, body)
    assert mirrored.coefficients["right_hand"] is pose.coefficients["left_hand"]
    assert_mirrored(body, pose, posed_arguments(body, rng))


def test_a_mirrored_body_keeps_its_names_and_orders(body):
    mirrored = mirror_model(body)
    assert mirrored.joint_names == body.joint_names
    assert mirrored.parents.tolist() == body.parents.tolist()
    assert [block.name for block in mirrored.pose_blocks] == ["body", "left_hand", "right_hand"]
    assert [block.joints for block in mirrored.pose_blocks] == [block.joints for block in body.pose_blocks]
    assert mirrored.landmarks["eyes"].names == body.landmarks["eyes"].names
    assert {name: part.tolist() for name, part in mirrored.parts.items()} == {
        name: part.tolist() for name, part in body.parts.items()
    }


def test_a_symmetric_body_is_its_own_mirror_image_and_takes_mirrored_poses(body, rng):
    # Averaging with the mirror image makes the content symmetric.
    image = mirror_model(body)
    averaged = {
        name: (getattr(body, name) + getattr(image, name)) / 2
        for name in ("template", "shape_directions", "joint_regressor", "skinning_weights", "pose_directions")
    }
    symmetric = body.replace(**averaged)
    pose = FullPose(numbers(rng, 1, 5, 3))
    vertices = symmetric(None, pose).vertices[0].numpy()
    mirrored = symmetric(None, mirror_pose(pose, symmetric)).vertices[0].numpy()
    np.testing.assert_allclose(mirrored, vertices[body.mirror_vertices] * [-1, 1, 1], atol=1e-12)


def assert_same(first, second):
    for name in (
        "template", "faces", "shape_directions", "expression_directions", "pose_directions",
        "skinning_weights", "parents",
    ):  # fmt: skip
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name), err_msg=name)
        assert getattr(first, name).dtype == getattr(second, name).dtype
    assert (first.joint_regressor != second.joint_regressor).nnz == 0
    assert (first.name, first.side, first.joint_names) == (second.name, second.side, second.joint_names)
    assert list(first.parts) == list(second.parts)
    for part in first.parts:
        np.testing.assert_array_equal(first.parts[part], second.parts[part])
    for one, other in zip(first.pose_blocks, second.pose_blocks, strict=True):
        assert (one.name, one.joints) == (other.name, other.joints)
        for name in ("mean", "components", "component_deviations", "limits"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
        np.testing.assert_array_equal(one.mixture.means, other.mixture.means)
        np.testing.assert_array_equal(one.mixture.covariances, other.mixture.covariances)
    for name, landmarks in first.landmarks.items():
        assert second.landmarks[name].names == landmarks.names
        assert (second.landmarks[name].weights != landmarks.weights).nnz == 0


@pytest.mark.parametrize("kind", ["hand", "body"])
def test_mirroring_twice_changes_no_bit(kind, request, rng):
    model = request.getfixturevalue(kind)
    assert_same(model, mirror_model(mirror_model(model)))
    pose = FullPose(numbers(rng, 2, model.joint_count, 3))
    twice = mirror_pose(mirror_pose(pose, model), mirror_model(model))
    assert torch.equal(twice.values, pose.values)


def test_side_names_winding_and_cut(hand):
    left = mirror_model(hand)
    assert (left.side, left.name) == ("left", "left_tube")
    assert left.joint_names[0] == "left_wrist"
    assert set(left.parts) == {"left_palm", "tip"}
    np.testing.assert_allclose(left.cut.point, hand.cut.point * [-1, 1, 1])
    np.testing.assert_allclose(left.cut.normal, hand.cut.normal * [-1, 1, 1])

    def signed_volume(model):
        a, b, c = model.template[model.faces].transpose(1, 0, 2) - model.template.mean(0)
        return np.einsum("ij,ij->", a, np.cross(b, c))

    np.testing.assert_allclose(signed_volume(left), signed_volume(hand), rtol=1e-12)
    assert signed_volume(left) > 0


def test_limits_hold_for_the_mirrored_pose_exactly_when_they_held_before(hand, rng):
    block, mirrored = hand.pose_blocks[0], mirror_model(hand).pose_blocks[0]
    poses = torch.tensor(rng.uniform(block.limits[:, 0] - 0.5, block.limits[:, 1] + 0.5, size=(500, 9)))
    images = mirror_pose(FullPose(poses.reshape(500, 3, 3))).values.reshape(500, 9).numpy()

    def inside(values, limits):
        return (values >= limits[:, 0]) & (values <= limits[:, 1])

    before = inside(poses.numpy(), block.limits)
    assert 0 < before.mean() < 1
    np.testing.assert_array_equal(inside(images, mirrored.limits), before)


def test_the_mixture_gives_mirrored_poses_the_same_density(hand, rng):
    mixture, mirrored = hand.pose_blocks[0].mixture, mirror_model(hand).pose_blocks[0].mixture
    pose = numbers(rng, 1, 3, 3)
    image = mirror_pose(FullPose(pose)).values.reshape(9).numpy()

    def distances(numbers, mixture):
        difference = numbers - mixture.means
        solved = np.linalg.solve(mixture.covariances, difference[..., None])[..., 0]
        return (difference * solved).sum(-1)

    np.testing.assert_allclose(
        distances(image, mirrored), distances(pose.reshape(9).numpy(), mixture), rtol=1e-9
    )


def test_dtypes_stay(hand):
    single = hand.replace(
        **{
            name: getattr(hand, name).astype(np.float32)
            for name in ("template", "shape_directions", "expression_directions", "pose_directions")
        }
    )
    left = mirror_model(single)
    assert left.template.dtype == left.pose_directions.dtype == left.shape_directions.dtype == np.float32
    points = np.ones((2, 3), dtype=np.float32)
    assert mirror_translation(points).dtype == np.float32


@pytest.mark.parametrize(
    ("name", "other"),
    [
        ("left_wrist", "right_wrist"),
        ("RightHand", "LeftHand"),
        ("hand.R", "hand.L"),
        ("l_eye", "r_eye"),
        ("little1", "little1"),
        ("lip", "lip"),
        ("collar", "collar"),
    ],
)
def test_sides_in_names(name, other):
    assert swap_sides(name) == other
    assert swap_sides(other) == name


def test_a_broken_symmetry_is_refused(body):
    with pytest.raises(ValueError, match="needs both mirror_vertices and mirror_joints"):
        mirror_model(body.replace(mirror_joints=None))
    with pytest.raises(ValueError, match="mirror_vertices: mirroring twice"):
        mirror_model(body.replace(mirror_vertices=np.roll(body.mirror_vertices, 1)))
    with pytest.raises(ValueError, match="root must be its own mirror image"):
        mirror_model(body.replace(mirror_joints=np.array([1, 0, 2, 3, 4])))
