"""Which path poses a surface, and what must hold on every path."""

import runpy
from pathlib import Path

import numpy as np
import pytest
import torch

from corporeal.model import forward
from corporeal.model.pose import FullPose, zero_pose
from corporeal.model.reference import reference_surface

SYNTHETIC = runpy.run_path(str(Path(__file__).parents[1] / "synthetic.py"))


@pytest.fixture
def model(rng):
    return SYNTHETIC["random_model"](rng)


def _pose(rng, batch=2, dtype=torch.float64):
    return FullPose(torch.tensor(rng.standard_normal((batch, 5, 3)), dtype=dtype))


@pytest.fixture
def taken(monkeypatch):
    """Names of the paths that were taken, in order."""
    names = []
    for name in ("fast_surface", "reference_surface"):
        original = getattr(forward, name)

        def counted(*args, name=name, original=original):
            names.append(name)
            return original(*args)

        monkeypatch.setattr(forward, name, counted)
    return names


def test_the_cpu_takes_the_kernels(model, rng, taken):
    for dtype in (torch.float32, torch.float64):
        model(None, _pose(rng, dtype=dtype))
    assert taken == ["fast_surface"] * 2


def test_other_devices_and_dtypes_take_plain_torch(model, taken):
    surface = model(None, zero_pose(5, 2, device="meta"))
    assert surface.vertices.shape == (2, 80, 3)
    model(None, zero_pose(5, 2, dtype=torch.bfloat16))
    assert taken == ["reference_surface"] * 2


@pytest.mark.filterwarnings("ignore:.torch.jit.script. is deprecated:DeprecationWarning")  # torch's own call
def test_functional_transforms_take_plain_torch(model, rng, taken):
    pose = _pose(rng, 1)
    by_pose = torch.func.jacfwd(lambda values: model(None, FullPose(values)).joints)(pose.values)
    assert by_pose.shape == (1, 5, 3, 1, 5, 3)
    assert taken == ["reference_surface"]


def test_zero_pose_and_shape_is_the_template_moved(model, rng):
    move = torch.tensor(rng.standard_normal((1, 3)))
    for batch in (1, 20):
        surface = model(None, zero_pose(5, batch, torch.float64), translation=move)
        expected = torch.as_tensor(model.template) + move
        torch.testing.assert_close(surface.vertices, expected.expand(batch, -1, -1), rtol=0, atol=1e-14)
        joints = torch.as_tensor(model.joint_regressor @ model.template) + move
        torch.testing.assert_close(surface.joints, joints.expand(batch, -1, -1), rtol=0, atol=1e-14)
        rotation = surface.T_world_joint[..., :3, :3]
        torch.testing.assert_close(rotation, torch.eye(3, dtype=torch.float64).expand_as(rotation))


def test_frames_are_rigid_and_start_at_the_joints(model, rng):
    for batch in (2, 20):
        surface = model(None, _pose(rng, batch), translation=torch.ones(batch, 3, dtype=torch.float64))
        T = surface.T_world_joint
        torch.testing.assert_close(T[..., :3, 3], surface.joints, rtol=0, atol=0)
        identity = torch.eye(3, dtype=torch.float64).expand(batch, 5, 3, 3)
        torch.testing.assert_close(T[..., :3, :3] @ T[..., :3, :3].mT, identity, rtol=0, atol=1e-13)
        bottom = torch.tensor([0.0, 0, 0, 1], dtype=torch.float64)
        torch.testing.assert_close(T[..., 3, :], bottom.expand(batch, 5, 4), rtol=0, atol=0)


def test_a_batch_is_its_members(model, rng):
    """Small batches, large batches and single surfaces go through different kernels."""
    pose, shape = _pose(rng, 21), torch.tensor(rng.standard_normal((21, 4)))
    together = model(shape, pose)
    for index in range(21):
        alone = model(shape[index : index + 1], FullPose(pose.values[index : index + 1]))
        torch.testing.assert_close(together.vertices[index], alone.vertices[0], rtol=0, atol=1e-13)


def test_one_shape_goes_with_many_poses(model, rng):
    pose, shape = _pose(rng, 6), torch.tensor(rng.standard_normal((1, 3)), requires_grad=True)
    surface = model(shape, pose)
    repeated = model(shape.expand(6, 3), pose)
    torch.testing.assert_close(surface.vertices, repeated.vertices, rtol=0, atol=0)
    surface.vertices.sum().backward()
    assert shape.grad.shape == (1, 3)


def test_four_representations_of_one_rotation_agree(model, rng):
    from corporeal.geometry import rotations

    pose = _pose(rng)
    matrices = pose.matrices()
    expected = model(None, pose).vertices
    for representation, values in (
        ("matrix", matrices),
        ("quaternion", rotations.quaternion_from_matrix(matrices)),
        ("6d", rotations.sixd_from_matrix(matrices)),
    ):
        got = model(None, FullPose(values, representation)).vertices
        torch.testing.assert_close(got, expected, rtol=0, atol=1e-13)


def test_without_shape_space_or_correctives(rng):
    model = SYNTHETIC["random_model"](rng, expressions=0)
    bare = model.replace(
        shape_directions=np.zeros((80, 3, 0)), pose_directions=np.zeros((80, 3, 0)), pose_blocks=()
    )
    for batch in (2, 20):
        pose = _pose(rng, batch)
        tensors = bare.tensors(torch.float64)
        origin = torch.zeros(batch, 3, dtype=torch.float64)
        nothing = torch.zeros(batch, 0, dtype=torch.float64)
        expected = reference_surface(tensors, nothing, pose.matrices(), origin, False)
        torch.testing.assert_close(bare(None, pose).vertices, expected.vertices, rtol=0, atol=1e-13)


def test_an_empty_batch_gives_an_empty_surface(model):
    assert model(None, zero_pose(5, 0)).vertices.shape == (0, 80, 3)
