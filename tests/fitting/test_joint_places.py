"""Joints placed by scans: a known displacement is found again, and nothing moves where nothing is wrong."""

import dataclasses

import numpy as np
import pytest

from corporeal.fitting.joint_places import (
    JointPlaceError,
    JointPlaceOptions,
    PosedScan,
    carried_by,
    place_joints,
    shift_slopes,
    with_shifted_joints,
)
from corporeal.geometry.normals import vertex_normals
from corporeal.model.files import open_model
from corporeal.model.jacobian import evaluate, linearise

_SHAPES = 5


@pytest.fixture(scope="module")
def true():
    model = open_model("start_hand")
    return model.replace(shape_directions=model.shape_directions[:, :, :_SHAPES])


@pytest.fixture(scope="module")
def scans(true):
    """Three hands in eight recorded poses; it begins two degrees and a fifth of a deviation off."""
    rng, block, made = np.random.default_rng(2), true.block("hand"), []
    for hand in range(3):
        shape = rng.standard_normal(_SHAPES)
        for number in range(8):
            pose = 0.3 * rng.standard_normal((true.joint_count, 3))
            drawn = rng.standard_normal(len(block.components)) * block.component_deviations
            pose[list(block.joints)] = (block.mean + drawn @ block.components).reshape(-1, 3)
            vertices = evaluate(true, shape, pose, np.zeros(3)).vertices
            points = _points_on(vertices, true.faces, 800, rng)
            begun = pose + np.deg2rad(2) * rng.standard_normal(pose.shape)
            fitted = shape + 0.2 * rng.standard_normal(_SHAPES)
            made.append(PosedScan(f"h{hand}_{number}", f"h{hand}", points, begun, fitted, np.zeros(3)))
    return made


def _points_on(vertices, faces, count, rng):
    """Points all over a surface."""
    corners = vertices[faces]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    chosen = rng.choice(len(faces), count, p=areas / areas.sum())
    return np.einsum("pi,pia->pa", rng.dirichlet(np.ones(3), count), corners[chosen])


@pytest.fixture(scope="module")
def displaced(true):
    """Along their bones: two knuckles by 3 mm, and a middle joint by 4."""
    shifts = np.zeros((true.joint_count, 3))
    shifts[true.joint_names.index("index1"), 0] = 0.003
    shifts[true.joint_names.index("ring1"), 0] = -0.003
    shifts[true.joint_names.index("middle2"), 0] = 0.004
    return shifts


def test_a_shift_moves_the_joints_of_the_template_alone(true, displaced):
    moved = with_shifted_joints(true, displaced)
    joints = true.joint_regressor @ true.template
    np.testing.assert_allclose(moved.joint_regressor @ true.template, joints + displaced, atol=1e-9)
    np.testing.assert_allclose(moved.joint_regressor.sum(axis=1), 1, atol=1e-9)
    far = true.template + [1.0, -2.0, 0.5]
    np.testing.assert_allclose(
        moved.joint_regressor @ far, joints + displaced + far[0] - true.template[0], atol=1e-9
    )


def test_the_jacobian_of_a_shift_is_its_slope(true):
    rng = np.random.default_rng(5)
    pose, direction = 0.5 * rng.standard_normal((2, true.joint_count, 3))
    direction[0] = 0
    shape, translation = rng.standard_normal(_SHAPES), rng.standard_normal(3)
    # With no shape the shift of the template is the shift of the hand.
    posed = linearise(true, 0 * shape, pose, translation)
    normals = vertex_normals(posed.vertices, true.faces)
    slopes = shift_slopes(posed, true.parents, carried_by(true), normals)
    found = np.einsum("vkb,kb->v", slopes, direction)
    step = 1e-5
    sides = [
        evaluate(with_shifted_joints(true, sign * step * direction), 0 * shape, pose, translation).vertices
        for sign in (1, -1)
    ]
    expected = np.einsum("va,va->v", normals, sides[0] - sides[1]) / (2 * step)
    np.testing.assert_allclose(found, expected, atol=1e-7)


@pytest.mark.slow
def test_joints_that_were_displaced_come_back(true, displaced, scans):
    wrong = with_shifted_joints(true, displaced)
    told = []
    placed = place_joints(wrong, scans, JointPlaceOptions(steps=8), on_step=lambda *step: told.append(step))
    assert told == list(enumerate(placed.rms_mm, start=1)) and len(told) == 8
    assert placed.rms_mm[-1] < 0.2 * placed.rms_mm[0]
    # Across the axis about which alone a joint turns; along it the surfaces tell nothing.
    assert np.abs(displaced + placed.shifts)[:, :2].max() < 0.8e-3
    assert np.linalg.norm(displaced + placed.shifts, axis=1).max() < 1.2e-3
    regressor = placed.model.joint_regressor
    assert regressor.data.min() >= 0
    np.testing.assert_allclose(regressor.sum(axis=1), 1, atol=1e-9)
    joints, right = regressor @ true.template, true.joint_regressor @ true.template
    assert np.linalg.norm(joints - right, axis=1).mean() < 0.6e-3
    for name in ("template", "skinning_weights", "pose_directions", "shape_directions"):
        assert getattr(placed.model, name) is getattr(wrong, name)


@pytest.mark.slow
def test_joints_that_are_right_stay(true, scans):
    placed = place_joints(true, scans, JointPlaceOptions(steps=8))
    assert np.abs(placed.shifts[0]).max() == 0, "the root's place cannot be told"
    assert np.linalg.norm(placed.shifts, axis=1).max() < 1.2e-3


def test_what_does_not_fit_is_refused_by_name(true, scans):
    with pytest.raises(JointPlaceError, match="none was given"):
        place_joints(true, [])
    with pytest.raises(JointPlaceError, match=r"h0_0: 15 joints and 5 .*, but 'hand' has 16 and 5"):
        place_joints(true, [dataclasses.replace(scans[0], pose=scans[0].pose[1:])])
    far = dataclasses.replace(scans[1], translation=np.full(3, 0.5))
    with pytest.raises(JointPlaceError, match=r"h0_1: 0 of its points are within 6 mm"):
        place_joints(true, [scans[0], far])
