"""People are adults, the same every time, and like themselves on both sides."""

import numpy as np
import pytest

from corporeal.geometry.normals import face_normals, vertex_normals
from corporeal.scans.simulation.files import HandSimulator, load_simulator
from corporeal.scans.simulation.identities import hand_at_rest, sample_subjects, slow_waves


@pytest.fixture(scope="module")
def simulator() -> HandSimulator:
    return load_simulator()


def test_subjects_are_determined_by_the_seed(simulator):
    few, many = sample_subjects(simulator, 3, 5), sample_subjects(simulator, 8, 5)
    for one, other in zip(few, many, strict=False):
        assert one.name == other.name
        np.testing.assert_array_equal(one.identity, other.identity)
        first, _ = hand_at_rest(simulator, one, "left")
        second, _ = hand_at_rest(simulator, other, "left")
        np.testing.assert_array_equal(first, second)
    assert len({subject.name for subject in many}) == 8
    assert not np.allclose(few[0].identity, sample_subjects(simulator, 1, 6)[0].identity)


def test_hands_have_the_lengths_of_adults(simulator):
    joints = simulator.joints + np.array(
        [simulator.identity_joints @ subject.identity for subject in sample_subjects(simulator, 200, 1)]
    )
    lengths = np.linalg.norm(joints[:, 18] - joints[:, 1], axis=1)
    assert abs(lengths.mean() - 0.185) < 0.004
    assert 0.008 < lengths.std() < 0.013
    assert lengths.min() > 0.145
    assert lengths.max() < 0.225
    np.testing.assert_allclose(joints[:, 1], 0, atol=1e-6)


def test_relief_is_a_person_s_own_and_leaves_the_joints(simulator):
    subject = sample_subjects(simulator, 1, 2)[0]
    surface, joints = hand_at_rest(simulator, subject, "right")
    plain = simulator.surface_vertices + simulator.identity_directions @ subject.identity
    np.testing.assert_allclose(joints, simulator.joints + simulator.identity_joints @ subject.identity)
    height = np.linalg.norm(surface - plain, axis=1)
    outward = np.einsum("na,na->n", surface - plain, vertex_normals(plain, simulator.surface_faces))
    # Along the normals, but for grooves and webs.
    assert np.quantile(np.abs(outward) / height, 0.05) > 0.8
    assert 0.5 * subject.relief < np.sqrt((height**2).mean()) < 1.5 * subject.relief
    assert height.max() < 2.5e-3


def test_the_left_hand_is_nearly_the_right_one(simulator):
    for subject in sample_subjects(simulator, 6, 3):
        right, _ = hand_at_rest(simulator, subject, "right")
        left, _ = hand_at_rest(simulator, subject, "left")
        hand = simulator.surface_vertices[:, 0] < 0
        apart = np.linalg.norm(right - left, axis=1)[hand]
        assert 0.1e-3 < apart.mean() < 3.5e-3
        other, _ = hand_at_rest(simulator, sample_subjects(simulator, 7, 3)[-1], "right")
        assert apart.mean() < np.linalg.norm(right - other, axis=1)[hand].mean()


def test_skins_stay_whole(simulator):
    """No face of a person turns over against the mean hand's."""
    before = face_normals(simulator.surface_vertices, simulator.surface_faces)
    for subject in sample_subjects(simulator, 20, 4):
        surface, _ = hand_at_rest(simulator, subject, "right")
        after = face_normals(surface, simulator.surface_faces)
        assert np.einsum("fa,fa->f", before, after).min() > 0


def test_waves_are_slow_and_of_unit_variance(rng):
    points = rng.uniform(-0.1, 0.1, (4000, 3))
    waves = slow_waves(points, np.random.default_rng(1))
    step = slow_waves(points + [1e-5, 0, 0], np.random.default_rng(1)) - waves
    assert 0.8 < waves.std() < 1.2
    # The steepest that waves of 30 mm and more can be, were all of them in phase.
    assert np.abs(step).max() / 1e-5 < np.sqrt(2 * 24) * 2 * np.pi / 0.03
