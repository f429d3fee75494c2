"""A person's joints that lie elsewhere in the skin than the model's are found by frames of that person."""

import numpy as np
import pytest

from corporeal.fitting.frame_data import FrameData, FramePoints
from corporeal.fitting.frame_fit import FrameFitter
from corporeal.fitting.joint_places import with_shifted_joints
from corporeal.fitting.options import TrackingOptions
from corporeal.fitting.subject_joints import FittedFrame, subject_joint_shifts
from corporeal.fitting.subject_template import personal_model
from corporeal.geometry.normals import vertex_normals
from corporeal.model.files import open_model
from corporeal.model.jacobian import evaluate
from corporeal.terms.model_fields import ModelParameters


@pytest.fixture(scope="module")
def body():
    model = open_model("body")
    return model.replace(shape_directions=model.shape_directions[:, :, :2])


def _fitter(model):
    return FrameFitter(model, TrackingOptions(), shape_count=2)


def _frames(body, rng, count):
    """Knees and elbows bent, differently on either side; every other vertex is measured."""
    frames = []
    for number in range(count):
        pose = np.zeros((body.joint_count, 3))
        for side, turn in (("left", -1), ("right", 1)):
            pose[body.joint_names.index(f"{side}_knee"), 0] = rng.uniform(0.2, 1.5)
            pose[body.joint_names.index(f"{side}_elbow"), 1] = turn * rng.uniform(0.2, 1.5)
        vertices = evaluate(body, np.zeros(2), pose, np.zeros(3)).vertices
        points = FramePoints(
            vertices[number % 2 :: 2], vertex_normals(vertices, body.faces)[number % 2 :: 2], 1e-4
        )
        near = pose + np.deg2rad(1) * rng.standard_normal(pose.shape)
        parameters = ModelParameters(np.zeros(3), near, np.zeros(2))
        frames.append(FittedFrame(FrameData(str(number), points, None), parameters))
    return frames


@pytest.mark.slow
def test_knees_and_elbows_that_lie_elsewhere_are_found_on_both_sides(body, rng):
    wrong = np.zeros((body.joint_count, 3))
    for side, outwards in (("left", 1), ("right", -1)):
        wrong[body.joint_names.index(f"{side}_knee")] = [0, -0.025, 0]
        wrong[body.joint_names.index(f"{side}_elbow")] = [-0.012 * outwards, 0, 0]
    found = subject_joint_shifts(_fitter(with_shifted_joints(body, wrong)), _frames(body, rng, 5))
    assert np.linalg.norm(found + wrong, axis=1)[np.linalg.norm(wrong, axis=1) > 0].max() < 4e-3
    mirrored = found[body.mirror_joints] * [-1, 1, 1]
    np.testing.assert_allclose(found, mirrored, atol=1e-12)
    body_joints = {0} | {
        joint for block in body.pose_blocks if block.name == "body" for joint in block.joints
    }
    others = [joint for joint in range(body.joint_count) if joint not in body_joints]
    assert not found[others].any() and not found[0].any()


def test_where_nothing_can_be_told_nothing_is_placed(body, rng):
    assert subject_joint_shifts(_fitter(body), []) is None
    frame = _frames(body, rng, 1)[0]
    few = FramePoints(frame.data.points.positions[:50], frame.data.points.normals[:50], 1e-4)
    assert (
        subject_joint_shifts(_fitter(body), [FittedFrame(FrameData("0", few, None), frame.parameters)])
        is None
    )
    hand = open_model("hand")
    parameters = ModelParameters(np.zeros(3), np.zeros((hand.joint_count, 3)), np.zeros(2))
    assert subject_joint_shifts(_fitter(hand), [FittedFrame(FrameData("0", few, None), parameters)]) is None


def test_a_person_has_joints_of_its_own(body):
    joints = body.joint_regressor @ body.template
    knee = body.joint_names.index("left_knee")
    moved = joints.copy()
    moved[knee] += [0.0, 0.03, -0.005]
    person = personal_model(body, body.template, moved)
    np.testing.assert_allclose(person.joint_regressor @ person.template, moved, atol=2e-4)
    assert person.joint_regressor.data.min() >= 0
    np.testing.assert_allclose(person.joint_regressor.sum(axis=1), 1, atol=1e-9)
