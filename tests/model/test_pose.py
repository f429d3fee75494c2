import runpy
from pathlib import Path

import numpy as np
import pytest
import torch

from corporeal.geometry import rotations
from corporeal.model.pose import CoefficientPose, FullPose, zero_pose

SYNTHETIC = runpy.run_path(str(Path(__file__).parents[1] / "synthetic.py"))


@pytest.fixture
def model(rng):
    return SYNTHETIC["random_model"](rng)


def numbers(rng, *shape):
    return torch.tensor(rng.standard_normal(shape))


def with_mean(model, included):
    blocks = [
        type(block)(**{**vars(block), "mean_included": included}) if block.name == "right_hand" else block
        for block in model.pose_blocks
    ]
    return model.replace(pose_blocks=tuple(blocks))


def test_the_type_says_what_the_numbers_are_never_their_count(model, rng):
    # Three components and one joint's axis-angle are both three numbers.
    three = numbers(rng, 1, 3)
    by_coefficients = model.full_pose(CoefficientPose(torch.zeros(1, 3).double(), {"end": three}))
    by_rotation = model.full_pose(CoefficientPose(torch.zeros(1, 3).double(), {}, {"end": three[:, None]}))
    assert torch.equal(by_rotation.values[:, 4], three)
    assert not torch.allclose(by_coefficients.values[:, 4], three)


@pytest.mark.parametrize("included", [True, False])
def test_coefficients_are_counted_from_the_mean_exactly_when_the_block_says_so(model, rng, included):
    block = with_mean(model, included).block("right_hand")
    assert np.abs(block.mean).min() > 0
    coefficients = numbers(rng, 4, 2)
    pose = CoefficientPose(numbers(rng, 4, 3), {"right_hand": coefficients})
    full = with_mean(model, included).full_pose(pose)
    wanted = coefficients.numpy() @ block.components[:2] + (block.mean if included else 0)
    np.testing.assert_allclose(full.values[:, list(block.joints)].reshape(4, 9), wanted, atol=1e-15)
    assert torch.equal(full.values[:, 0], pose.root)
    assert not full.values[:, 4].any()


def test_a_full_pose_has_no_mean_added(model, rng):
    pose = FullPose(numbers(rng, 2, 5, 3))
    assert model.full_pose(pose) is pose


def test_rotations_of_a_block_are_absolute(model, rng):
    rotation = numbers(rng, 2, 3, 3)
    full = model.full_pose(CoefficientPose(numbers(rng, 2, 3), {}, {"right_hand": rotation}))
    assert torch.equal(full.values[:, [1, 2, 3]], rotation)


def test_poses_are_differentiable_in_their_coefficients(model, rng):
    def joints(root, coefficients, rotation):
        pose = CoefficientPose(root, {"right_hand": coefficients}, {"end": rotation})
        return model(None, pose).joints

    inputs = (numbers(rng, 2, 3), numbers(rng, 2, 2), numbers(rng, 2, 1, 3))
    assert torch.autograd.gradcheck(joints, tuple(part.requires_grad_() for part in inputs))


def test_axis_angles_come_from_every_representation(rng):
    axis_angle = 0.5 * numbers(rng, 2, 5, 3)
    matrices = rotations.matrix_from_axis_angle(axis_angle)
    poses = {
        "axis_angle": axis_angle,
        "matrix": matrices,
        "quaternion": rotations.quaternion_from_matrix(matrices),
        "6d": rotations.sixd_from_matrix(matrices),
    }
    for representation, values in poses.items():
        pose = FullPose(values, representation)
        assert (pose.batch, pose.joint_count) == (2, 5)
        np.testing.assert_allclose(pose.matrices(), matrices, atol=1e-14)
        np.testing.assert_allclose(pose.axis_angles(), axis_angle, atol=1e-14)


def test_the_zero_pose_turns_nothing():
    pose = zero_pose(5, batch=2, dtype=torch.float64)
    np.testing.assert_array_equal(pose.matrices(), np.tile(np.eye(3), (2, 5, 1, 1)))


@pytest.mark.parametrize(
    ("shape", "representation"),
    [((2, 15), "axis_angle"), ((2, 5, 4), "axis_angle"), ((2, 5, 3), "quaternion"), ((2, 5, 9), "matrix")],
)
def test_wrong_shapes_are_refused_with_the_shape_that_is_wanted(shape, representation):
    with pytest.raises(ValueError, match=rf"pose: expected a tensor .* for {representation}, got"):
        FullPose(torch.zeros(shape), representation)


def test_what_a_model_cannot_take_is_refused(model, rng):
    root = numbers(rng, 1, 3)
    with pytest.raises(ValueError, match="'end' is given both by coefficients and by rotations"):
        CoefficientPose(root, {"end": numbers(rng, 1, 2)}, {"end": numbers(rng, 1, 1, 3)})
    with pytest.raises(KeyError, match="pose block 'jaw' is not among right_hand, end"):
        model.full_pose(CoefficientPose(root, {"jaw": numbers(rng, 1, 2)}))
    with pytest.raises(ValueError, match="4 coefficients for the 3 components of block 'right_hand'"):
        model.full_pose(CoefficientPose(root, {"right_hand": numbers(rng, 1, 4)}))
    with pytest.raises(ValueError, match=r"block 'right_hand' takes \(batch, 3, 3\)"):
        model.full_pose(CoefficientPose(root, {}, {"right_hand": numbers(rng, 1, 2, 3)}))
    with pytest.raises(ValueError, match="pose: 4 joints for a model with 5"):
        model.full_pose(FullPose(numbers(rng, 1, 4, 3)))
