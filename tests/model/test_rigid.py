import runpy
from pathlib import Path

import numpy as np
import pytest
import torch

from corporeal.geometry import rotations
from corporeal.model.pose import CoefficientPose, FullPose
from corporeal.model.rigid import apply_rigid

SYNTHETIC = runpy.run_path(str(Path(__file__).parents[1] / "synthetic.py"))
REPRESENTATIONS = {
    "axis_angle": rotations.axis_angle_from_matrix,
    "matrix": lambda matrix: matrix,
    "quaternion": rotations.quaternion_from_matrix,
    "6d": rotations.sixd_from_matrix,
}


@pytest.fixture
def model(rng):
    return SYNTHETIC["random_model"](rng)


def numbers(rng, *shape):
    return torch.tensor(rng.standard_normal(shape))


def motion(rng, batch):
    return rotations.matrix_from_axis_angle(2 * numbers(rng, batch, 3)), numbers(rng, batch, 3)


def assert_moved(model, R, t, shape, pose, translation, expression):
    before = model(shape, pose, expression, translation)
    pose_after, translation_after = apply_rigid(model, R, t, shape, pose, translation, expression)
    assert type(pose_after) is type(pose)
    after = model(shape, pose_after, expression, translation_after)
    wanted = before.vertices @ R.transpose(-1, -2) + t.reshape(-1, 1, 3)
    np.testing.assert_allclose(after.vertices.numpy(), wanted.expand_as(after.vertices).numpy(), atol=1e-12)
    rotation = R.reshape(-1, 1, 3, 3) @ before.T_world_joint[..., :3, :3]
    np.testing.assert_allclose(
        after.T_world_joint[..., :3, :3].numpy(),
        rotation.expand_as(after.T_world_joint[..., :3, :3]).numpy(),
        atol=1e-12,
    )
    return pose_after


@pytest.mark.parametrize("representation", REPRESENTATIONS)
def test_the_parameters_give_the_moved_surface(model, rng, representation):
    matrices = rotations.matrix_from_axis_angle(numbers(rng, 4, model.joint_count, 3))
    pose = FullPose(REPRESENTATIONS[representation](matrices), representation)
    after = assert_moved(
        model, *motion(rng, 4), numbers(rng, 4, 3), pose, numbers(rng, 4, 3), numbers(rng, 4, 2)
    )
    assert after.representation == representation
    assert torch.equal(after.values[:, 1:], pose.values[:, 1:])


def test_coefficients_keep_their_type(model, rng):
    pose = CoefficientPose(
        numbers(rng, 4, 3), {"right_hand": numbers(rng, 4, 2)}, {"end": numbers(rng, 4, 1, 3)}
    )
    after = assert_moved(model, *motion(rng, 4), numbers(rng, 4, 3), pose, numbers(rng, 4, 3), None)
    assert torch.equal(after.coefficients["right_hand"], pose.coefficients["right_hand"])


@pytest.mark.parametrize(("poses", "motions", "shapes"), [(1, 5, 1), (5, 1, 1), (5, 1, 5), (1, 5, 5)])
def test_batches_of_one_go_with_any_number(model, rng, poses, motions, shapes):
    R, t = motion(rng, motions)
    pose = FullPose(numbers(rng, poses, model.joint_count, 3))
    shape = numbers(rng, shapes, 4)
    after, translation = apply_rigid(model, R, t, shape, pose, None)
    moved = model(shape, after, None, translation).vertices
    before = model(shape, FullPose(pose.values.expand(5, -1, -1))).vertices
    wanted = before @ R.transpose(-1, -2) + t[:, None]
    np.testing.assert_allclose(moved.numpy(), wanted.numpy(), atol=1e-12)


def test_one_motion_without_batch(model, rng):
    R, t = motion(rng, 1)
    pose = FullPose(numbers(rng, 2, model.joint_count, 3))
    assert_moved(model, R[0], t[0], None, pose, None, None)


def test_turning_only_the_root_would_misplace_the_surface(model):
    # The root stands 0.7 m from the origin; a half turn about y puts it on the other side.
    R = rotations.matrix_from_axis_angle(torch.tensor([0.0, np.pi, 0], dtype=torch.float64))
    pose = FullPose(torch.zeros(1, model.joint_count, 3, dtype=torch.float64))
    _, translation = apply_rigid(model, R, torch.zeros(3, dtype=torch.float64), None, pose, None)
    assert translation.norm() > 1.3


def test_gradients_pass_through_motion_shape_and_pose(model, rng):
    turn, t, shape = numbers(rng, 2, 3), numbers(rng, 2, 3), numbers(rng, 2, 4)
    values, translation = numbers(rng, 2, model.joint_count, 3), numbers(rng, 2, 3)

    def moved(turn, t, shape, values, translation):
        pose, shift = apply_rigid(
            model, rotations.matrix_from_axis_angle(turn), t, shape, FullPose(values), translation
        )
        return pose.values, shift

    inputs = tuple(part.requires_grad_() for part in (turn, t, shape, values, translation))
    assert torch.autograd.gradcheck(moved, inputs)


def test_batches_that_do_not_match_are_refused(model, rng):
    R, t = motion(rng, 3)
    pose = FullPose(numbers(rng, 2, model.joint_count, 3))
    with pytest.raises(ValueError, match="pose: batch of 2 where others hold 3"):
        apply_rigid(model, R, t, None, pose, None)
