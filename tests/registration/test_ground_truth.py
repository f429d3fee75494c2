import numpy as np
import pytest

from corporeal.registration.ground_truth import errors_against_truth, flagging


def grid() -> tuple[np.ndarray, np.ndarray]:
    """A flat sheet in the plane z = 0."""
    x, y = np.meshgrid(np.arange(4.0), np.arange(4.0))
    points = np.stack([x.ravel(), y.ravel(), np.zeros(16)], axis=1)
    faces = []
    for row in range(3):
        for column in range(3):
            a = 4 * row + column
            faces += [[a, a + 1, a + 4], [a + 1, a + 5, a + 4]]
    return points, np.array(faces)


def test_parts_of_a_known_offset():
    points, faces = grid()
    errors = errors_against_truth(points + [0.003, 0, -0.004], points, faces)
    np.testing.assert_allclose([errors.v2v, errors.normal, errors.tangential], [5, 4, 3], atol=1e-9)
    assert errors.joints is None


def test_either_winding_gives_the_same(rng):
    points, faces = grid()
    points = points + 0.1 * rng.standard_normal(points.shape)
    moved = points + 0.01 * rng.standard_normal(points.shape)
    one = errors_against_truth(moved, points, faces)
    other = errors_against_truth(moved, points, np.ascontiguousarray(faces[:, ::-1]))
    np.testing.assert_allclose([one.normal, one.tangential], [other.normal, other.tangential], rtol=1e-12)


def test_pythagoras_holds_per_vertex(rng):
    points, faces = grid()
    moved = points.copy()
    moved[5] += [0.006, 0, 0.008]
    errors = errors_against_truth(moved, points, faces, points[:3] + [0, 0.002, 0], points[:3])
    np.testing.assert_allclose([errors.v2v_max, 16 * errors.v2v], 10)
    np.testing.assert_allclose([16 * errors.normal, 16 * errors.tangential, errors.joints], [8, 6, 2])


def test_not_finite_is_refused():
    points, faces = grid()
    with pytest.raises(ValueError, match="finite"):
        errors_against_truth(np.full_like(points, np.nan), points, faces)


def test_flagging_counts_failed_and_doubtful_apart():
    v2v = {"a": 1.0, "b": 4.0, "c": 4.1, "d": None, "e": 9.0, "f": float("nan"), "g": 2.0}
    status = dict(
        zip("abcdefg", ("ok", "failed", "failed", "failed", "doubtful", "ok", "doubtful"), strict=True)
    )
    result = flagging(status, v2v)
    assert (result.scans, result.true_failures, result.without_registration) == (7, 4, 1)
    assert (result.failures_marked_failed, result.failures_marked_doubtful) == (0.5, 0.25)
    np.testing.assert_allclose([result.others_marked_failed, result.others_marked_doubtful], [1 / 3, 1 / 3])


def test_no_failure_has_no_share():
    assert flagging({"a": "ok"}, {"a": 1.0}).failures_marked_failed is None
