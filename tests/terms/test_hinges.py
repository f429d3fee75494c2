"""Elbows and knees: bending and turning the forearm is free, bending it sideways is not."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from corporeal.model.files import open_model
from corporeal.model.jacobian import ParameterColumns
from corporeal.solve.problem import PARAMETERS
from corporeal.terms.hinges import SLACK, hinge_terms

SIGMA = 0.03


@pytest.fixture(scope="module")
def hinges():
    body = open_model("body")
    (term,) = hinge_terms(body, ParameterColumns.of_counts(body.joint_count, 0, 0), SIGMA)
    return body, term


def _cost(hinges, joint, turn):
    body, term = hinges
    pose = np.zeros((body.joint_count, 3))
    pose[joint] = turn.as_rotvec()
    return term.at({PARAMETERS: np.concatenate([np.zeros(3), pose.ravel()])}).cost


def test_elbows_and_knees_are_found(hinges):
    body, term = hinges
    assert {body.joint_names[joint] for joint in term.joints} == {
        "left_elbow", "right_elbow", "left_knee", "right_knee",
    }  # fmt: skip


def test_a_hand_has_none():
    hand = open_model("hand")
    assert hinge_terms(hand, ParameterColumns.of_counts(hand.joint_count, 0, 0), SIGMA) == []


def test_bending_and_turning_about_the_bone_are_free(hinges, rng):
    _, term = hinges
    for joint, axis, bone in zip(term.joints, term.axes, term.bones, strict=True):
        for bend, turn in rng.uniform((-SLACK, -2.5), 2.5, size=(4, 2)):
            turned = Rotation.from_rotvec(bend * axis) * Rotation.from_rotvec(turn * bone)
            assert _cost(hinges, joint, turned) < 1e-20


def test_bending_sideways_costs_the_square_of_the_sine(hinges):
    _, term = hinges
    for joint, axis, bone in zip(term.joints, term.axes, term.bones, strict=True):
        sideways = Rotation.from_rotvec(0.3 * np.cross(axis, bone))
        assert _cost(hinges, joint, sideways) == pytest.approx(0.5 * (np.sin(0.3) / SIGMA) ** 2, rel=1e-9)


def test_bending_to_the_wrong_side_costs_the_angle_beyond_the_slack(hinges):
    _, term = hinges
    for joint, axis in zip(term.joints, term.axes, strict=True):
        backward = Rotation.from_rotvec(-(SLACK + 0.2) * axis)
        assert _cost(hinges, joint, backward) == pytest.approx(0.5 * (0.2 / SIGMA) ** 2, rel=1e-9)


def test_elbows_bend_forward_and_knees_backward(hinges):
    body, term = hinges
    for joint, axis, bone in zip(term.joints, term.axes, term.bones, strict=True):
        ahead = np.cross(axis, bone)[2]
        assert ahead > 0.9 if "elbow" in body.joint_names[joint] else ahead < -0.9
