"""R^2 against cases that are known, and alignment."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from corporeal.learning.evaluation.truth import compare_with_truth


def surfaces_of(rng):
    without = 0.1 * rng.normal(size=(5, 40, 3))
    bulge = 2e-3 * rng.normal(size=without.shape) * np.array([0.2, 1, 1, 2, 3])[:, None, None]
    return without, bulge


def test_half_of_the_correctives_explains_three_quarters(rng):
    without, bulge = surfaces_of(rng)
    found = compare_with_truth("m", without + 0.5 * bulge, without, without + bulge, limit=0.6)
    assert found.r_squared == pytest.approx(0.75)
    assert found.r_squared_worst == pytest.approx(0.75)
    assert found.met is True and found.joint_error is None and found.aligned is False
    assert found.error.mean == pytest.approx(0.5e3 * np.linalg.norm(bulge, axis=2).mean())
    assert compare_with_truth("m", without, without, without + bulge).r_squared == 0


def test_pooled_weighs_scans_by_what_there_is_to_explain(rng):
    without, bulge = surfaces_of(rng)
    share = np.array([-1.0, 1, 1, 1, 1])[:, None, None]
    found = compare_with_truth("m", without + share * bulge, without, without + bulge, limit=0.99)
    squared = (bulge**2).sum(axis=(1, 2))
    assert found.r_squared == pytest.approx(1 - 4 * squared[0] / squared.sum())
    assert found.r_squared_worst == pytest.approx(-3)
    assert found.r_squared_median == pytest.approx(1)


def test_alignment_takes_a_rigid_motion_out_and_takes_the_joints_along(rng):
    without, bulge = surfaces_of(rng)
    truth, joints = without + bulge, 0.1 * rng.normal(size=(5, 3, 3))
    R, t = Rotation.random(random_state=5).as_matrix(), np.array([0.1, -0.2, 0.3])
    moved = [part @ R.T + t for part in (without + 0.5 * bulge, without, joints)]
    found = compare_with_truth("m", moved[0], moved[1], truth, joints=(moved[2], joints), aligned=True)
    plain = compare_with_truth("m", without + 0.5 * bulge, without, truth, joints=(joints, joints))
    assert found.r_squared == pytest.approx(plain.r_squared, abs=0.02)
    assert found.error.mean <= plain.error.mean * 1.001
    assert plain.joint_error.p95 == 0 and found.joint_error.mean < 1
    assert compare_with_truth("m", moved[0], moved[1], truth).error.mean > 100


def test_joint_errors_are_distances_in_millimetres(rng):
    without, bulge = surfaces_of(rng)
    joints = rng.normal(size=(5, 3, 3))
    found = compare_with_truth(
        "m", without, without, without + bulge, joints=(joints, joints + [0, 3e-3, 4e-3])
    )
    assert (found.joint_error.mean, found.joint_error.p95) == (pytest.approx(5), pytest.approx(5))


def test_nothing_to_explain_is_refused(rng):
    without, bulge = surfaces_of(rng)
    bulge[2] = 0
    with pytest.raises(ValueError, match="nothing to explain"):
        compare_with_truth("m", without, without, without + bulge)
    with pytest.raises(ValueError, match="one scan"):
        compare_with_truth("m", without[:0], without[:0], without[:0])
