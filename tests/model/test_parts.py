import runpy
from pathlib import Path

import numpy as np
import pytest
import torch

from corporeal.model.parts import select_part
from corporeal.model.pose import CoefficientPose, FullPose

SYNTHETIC = runpy.run_path(str(Path(__file__).parents[1] / "synthetic.py"))


@pytest.fixture
def model(rng):
    return SYNTHETIC["random_model"](rng, rings=16)


def numbers(rng, *shape):
    return torch.tensor(rng.standard_normal(shape))


def far_vertices(model):
    """The far end of the tube, where the second chain is; the regressor rows of joint 3 lose vertices."""
    return np.flatnonzero(model.template[:, 0] < model.template[:, 0].max() - 0.1)


def test_the_part_of_the_posed_whole_is_the_posed_part(model, rng):
    kept = far_vertices(model)
    part = select_part(model, kept, ["b1", "b2"], name="end")
    shape, expression, translation = numbers(rng, 3, 4), numbers(rng, 3, 2), numbers(rng, 3, 3)
    values = torch.zeros(3, 5, 3, dtype=torch.float64)
    values[:, 4] = numbers(rng, 3, 3)
    whole = model(shape, FullPose(values), expression, translation)
    cut = part(shape, FullPose(values[:, 3:]), expression, translation)
    np.testing.assert_allclose(cut.vertices.numpy(), whole.vertices[:, kept].numpy(), atol=1e-10)
    np.testing.assert_allclose(cut.T_world_joint.numpy(), whole.T_world_joint[:, 3:].numpy(), atol=1e-10)
    assert np.abs(whole.vertices.numpy() - model(shape, FullPose(0 * values)).vertices.numpy()).max() > 0.01


def test_a_dropped_joint_in_between_is_carried_by_its_ancestor(model, rng):
    everything = np.arange(model.vertex_count)
    part = select_part(model, everything, [0, 2, 3, 4], name="without a1")
    assert part.parents.tolist() == [-1, 0, 0, 2]
    values = numbers(rng, 2, 5, 3)
    values[:, 1] = 0
    whole = model(None, FullPose(values))
    cut = part(None, FullPose(values[:, [0, 2, 3, 4]]))
    np.testing.assert_allclose(cut.vertices.numpy(), whole.vertices.numpy(), atol=1e-12)


def test_rows_that_keep_their_vertices_stay_and_all_rows_stay_valid(model):
    part = select_part(model, far_vertices(model), ["b1", "b2"], name="end")
    np.testing.assert_allclose(part.joint_regressor.sum(axis=1), 1, atol=1e-12)
    np.testing.assert_allclose(part.skinning_weights.sum(axis=1), 1, atol=1e-12)
    kept = far_vertices(model)
    for row, bone in enumerate((3, 4)):
        original = model.joint_regressor[[bone]].toarray()[0]
        whole = np.isclose(original[kept].sum(), 1)
        assert np.allclose(part.joint_regressor[[row]].toarray()[0], original[kept]) == whole


def test_faces_parts_and_landmarks_follow(model):
    kept = far_vertices(model)
    part = select_part(model, kept, ["b1", "b2"], name="end", side="right")
    assert part.side == "right"
    old_faces = {tuple(face) for face in model.faces if np.isin(face, kept).all()}
    assert {tuple(kept[face]) for face in part.faces} == old_faces
    assert set(part.parts) == {"tip"}
    np.testing.assert_array_equal(kept[part.parts["tip"]], model.parts["tip"])
    surviving = [
        name
        for name, row in zip(model.landmarks["points"].names, model.landmarks["points"].weights, strict=True)
        if np.isin(row.indices, kept).all()
    ]
    assert 0 < len(surviving) < 4
    assert part.landmarks["points"].names == tuple(surviving)
    before = model.landmarks["points"].reordered(surviving).positions(model.template, np.zeros((5, 3)))
    np.testing.assert_allclose(part.landmarks["points"].positions(part.template, np.zeros((2, 3))), before)


def test_coefficients_mean_the_same_rotations(model, rng):
    part = select_part(model, np.arange(model.vertex_count), ["right_wrist", "a1", "a2"], name="first chain")
    pose = CoefficientPose(numbers(rng, 2, 3), {"right_hand": numbers(rng, 2, 3)})
    assert [block.name for block in part.pose_blocks] == ["right_hand"]
    np.testing.assert_allclose(part.full_pose(pose).values, model.full_pose(pose).values[:, :3])
    np.testing.assert_array_equal(part.pose_blocks[0].limits, model.pose_blocks[0].limits[:6])


def test_parts_are_chosen_by_name(rng):
    body = SYNTHETIC["random_body"](rng)
    arm = select_part(body, ["left_arm"], ["pelvis", "left_shoulder", "left_wrist"], name="arm", side="left")
    np.testing.assert_array_equal(arm.template, body.template[body.parts["left_arm"]])
    assert arm.mirror_vertices is None
    assert arm.joint_names == ("pelvis", "left_shoulder", "left_wrist")
    both = select_part(body, ["left_arm", "right_arm"], ["pelvis", "left_wrist", "right_wrist"], name="both")
    np.testing.assert_array_equal(both.mirror_vertices, body.mirror_vertices)
    np.testing.assert_array_equal(both.mirror_joints, [0, 2, 1])


def test_what_cannot_be_cut_is_refused(model):
    everything = np.arange(model.vertex_count)
    with pytest.raises(KeyError, match="part 'thumb' is not among right_palm, tip"):
        select_part(model, ["thumb"], [0], name="x")
    with pytest.raises(KeyError, match="joint 'elbow' is not among"):
        select_part(model, everything, ["elbow"], name="x")
    with pytest.raises(ValueError, match="exactly one joint above all others, got a1, b1"):
        select_part(model, everything, ["a1", "a2", "b1"], name="x")
    with pytest.raises(ValueError, match="vertices: expected some of"):
        select_part(model, np.zeros(0, dtype=int), [0], name="x")
    with pytest.raises(ValueError, match="cannot give the rest position of 'b2'"):
        select_part(model, np.arange(6), ["b2"], name="x")
