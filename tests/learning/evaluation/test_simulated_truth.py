"""The simulator's truth as a model sees it: exact where the model is the truth."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from corporeal.geometry.rotations_numeric import axis_angle_from_matrix
from corporeal.learning.evaluation.simulated_truth import (
    TrueScan,
    ZeroPose,
    against_simulation,
    flexed,
    planned_scans,
    true_pose,
    true_template,
    zero_pose,
)
from corporeal.learning.personal import personal_model
from corporeal.model.files import open_model
from corporeal.model.jacobian import evaluate
from corporeal.scans.simulation.files import load_simulator
from corporeal.scans.simulation.protocol import protocol_poses
from corporeal.scans.simulation.simulate import PlannedScan, ScanTruth, SimulationOptions, true_hand
from corporeal.scans.simulation.skeleton import bone_transforms

pytestmark = pytest.mark.slow
OPTIONS = SimulationOptions(subjects=1, seed=7)
HAND = "s01/right"


@pytest.fixture(scope="module")
def known_zero():
    """Fingers bent by 8 degrees about axes of their own, in a frame turned by 5 degrees."""
    generator = np.random.default_rng(3)
    axes = generator.standard_normal((16, 3))
    axes *= np.deg2rad(8) / np.linalg.norm(axes, axis=1, keepdims=True)
    axes[0] = 0
    frame = Rotation.from_rotvec(np.deg2rad([3.0, -4, 0])).as_matrix()
    return ZeroPose(frame, Rotation.from_rotvec(axes).as_matrix())


@pytest.fixture(scope="module")
def template(known_zero):
    return true_template(true_hand(OPTIONS, 0, "right"), known_zero)


def scan(name, angles, template, surface=None, number=1):
    """A scan's truth in a frame of its own; its surface is given, or the template."""
    hand = template.hand
    motions = bone_transforms(load_simulator(), hand.joints, angles)
    joints = np.einsum("kab,kb->ka", motions[:, :3, :3], hand.joints[:17]) + motions[:, :3, 3]
    R, t = Rotation.from_rotvec([0.4, -1.2, 0.3]).as_matrix(), np.array([0.1, 0.2, -0.3])
    vertices = template.vertices if surface is None else surface
    truth = ScanTruth(vertices, joints[1:] @ R.T + t, angles, "", 1.0, 1.0, 0.5, 0.0)
    return TrueScan(PlannedScan(f"s01_p{number:02d}_right", 0, "right", name, ""), HAND, truth)


@pytest.fixture(scope="module")
def bent():
    return next(pose.angles for pose in protocol_poses() if pose.name == "p23-medium-wrap")


def test_the_zero_pose_of_templates_is_found(known_zero, template, bent):
    """To a degree; at the thumb's first bone, whose skin hardly twists with it, to two."""
    found = zero_pose(open_model("hand"), {HAND: template.vertices}, [scan("x", bent, template)], OPTIONS)
    off = found.turns.transpose(0, 2, 1) @ known_zero.turns
    degrees = np.rad2deg(np.linalg.norm(axis_angle_from_matrix(off), axis=1))
    assert degrees[13] < 2.0
    assert np.delete(degrees, 13).max() < 1.0
    frame = (found.R_model_simulator.T @ known_zero.R_model_simulator)[None]
    assert np.rad2deg(np.linalg.norm(axis_angle_from_matrix(frame))) < 0.5


def test_true_joints_turned_by_the_true_pose_are_the_posed_ones(known_zero, template, bent):
    """Forward kinematics of joints alone: what a model with the true joints would do."""
    truth = scan("x", bent, template).truth
    model = open_model("hand")
    found = true_pose(template, truth, template.joints, known_zero)
    # A regressor that gives the true joints: one vertex is moved onto each of them.
    vertices = template.vertices.copy()
    vertices[:16] = template.joints
    regressor = model.joint_regressor[:, :].tolil() * 0
    regressor[np.arange(16), np.arange(16)] = 1
    exact = personal_model(model.replace(joint_regressor=regressor.tocsr()), vertices)
    joints = evaluate(exact, np.zeros(0), found.pose, found.translation).joints
    np.testing.assert_allclose(joints @ found.R_scan_model.T + found.t_scan_model, truth.joints, atol=1e-9)


def test_a_model_that_is_the_truth_has_an_r_squared_of_one(known_zero, template, bent):
    rng = np.random.default_rng(5)
    hand = open_model("hand")
    model = hand.replace(pose_directions=1e-3 * rng.standard_normal((hand.vertex_count, 3, 135)))
    bare = scan("x", bent, template)
    zero = zero_pose(model, {HAND: template.vertices}, [bare], OPTIONS)
    settled = true_template(template.hand, zero)
    personal = personal_model(model, settled.vertices)
    true = true_pose(settled, bare.truth, np.asarray(model.joint_regressor @ settled.vertices), zero)
    posed = evaluate(personal, np.zeros(0), true.pose, true.translation).vertices
    surface = posed @ true.R_scan_model.T + true.t_scan_model
    truth = dataclasses.replace(bare, truth=dataclasses.replace(bare.truth, template=surface))
    result = against_simulation("made", model, {HAND: template.vertices}, [truth], OPTIONS)
    assert result.r_squared > 1 - 1e-12
    assert result.error.mean < 1e-9
    assert result.error_without.mean > 0.5
    off = np.linalg.norm(model.joint_regressor @ settled.vertices - settled.joints, axis=1)
    assert result.joint_error.mean == pytest.approx(1e3 * off.mean())


def test_flexed_scans_are_those_with_bent_fingers(template, bent):
    flat = np.zeros((17, 3))
    thumb = flat.copy()
    thumb[14:, 0] = 80
    scans = [
        scan("x", angles, template, number=n) for n, angles in enumerate([flat, bent, thumb, bent, bent])
    ]
    assert [s.planned.name for s in flexed(scans, 9)] == ["s01_p01_right", "s01_p03_right", "s01_p04_right"]
    assert [s.planned.name for s in flexed(scans, 2)] == ["s01_p01_right", "s01_p04_right"]


def test_left_hands_and_other_templates_are_refused(template, bent):
    right = scan("x", bent, template)
    left = dataclasses.replace(right, planned=dataclasses.replace(right.planned, side="left"))
    with pytest.raises(ValueError, match="right hands"):
        against_simulation("x", open_model("hand"), {HAND: template.vertices}, [left], OPTIONS)
    short = dataclasses.replace(right, truth=dataclasses.replace(right.truth, template=template.vertices[:9]))
    with pytest.raises(ValueError, match="not the template"):
        against_simulation("x", open_model("hand"), {HAND: template.vertices}, [short], OPTIONS)


def test_whose_hand_a_scan_shows():
    plans = planned_scans(SimulationOptions(subjects=2, seed=1))
    assert {hand for _, hand in plans.values()} == {
        f"s0{n}/{side}" for n in (1, 2) for side in ("left", "right")
    }
    assert plans["s02_p01_left"][1] == "s02/left"
