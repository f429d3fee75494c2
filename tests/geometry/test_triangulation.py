import numpy as np
import pytest

from corporeal.geometry.cameras import Pinhole
from corporeal.geometry.triangulation import reprojection, robust_triangulation, triangulate


@pytest.fixture
def seen(rng):
    """Twelve cameras round twenty points: projections, exact pixels, the points."""
    points = rng.normal(size=(20, 3)) * 0.05
    cameras = [
        Pinhole.look_at(eye / np.linalg.norm(eye) * 0.6, np.zeros(3), rng.normal(size=3), 0.6, (320, 320))
        for eye in rng.normal(size=(12, 3))
    ]
    pixels = np.array([camera.project(points)[0] for camera in cameras])
    return np.array([camera.projection for camera in cameras]), pixels, points


def test_exact_observations_give_the_points_back(seen):
    projections, pixels, points = seen
    np.testing.assert_allclose(triangulate(projections, pixels), points, atol=1e-12)
    np.testing.assert_allclose(triangulate(projections[:2], pixels[:2]), points, atol=1e-11)
    assert reprojection(projections, pixels, points).max() < 1e-9


def test_weights_choose_the_views(seen, rng):
    projections, pixels, points = seen
    wrong = pixels.copy()
    wrong[5] += 40
    weights = np.ones(pixels.shape[:2])
    weights[5] = 0
    np.testing.assert_allclose(triangulate(projections, wrong, weights), points, atol=1e-12)


def test_batches_are_the_same_as_single_calls(seen, rng):
    projections, pixels, _ = seen
    noisy = pixels + rng.normal(size=pixels.shape)
    pairs = np.array([[0, 1], [3, 7], [2, 9]])
    together = triangulate(projections[pairs], noisy[pairs])
    for pair, points in zip(pairs, together, strict=True):
        np.testing.assert_allclose(points, triangulate(projections[pair], noisy[pair]), atol=1e-13)


def test_noise_of_a_pixel_is_averaged_to_the_least_reprojection_error(seen, rng):
    projections, pixels, points = seen
    noisy = pixels + rng.normal(size=pixels.shape)
    found = triangulate(projections, noisy)
    best = np.square(reprojection(projections, noisy, found)).sum()
    for _ in range(20):  # a stationary point up to the small bias of the linear method
        step = rng.normal(size=points.shape) * 2e-4
        assert np.square(reprojection(projections, noisy, found + step)).sum() > best


def test_wrong_views_and_wrong_observations_do_not_matter(seen, rng):
    projections, pixels, points = seen
    wrong = pixels.copy()
    wrong[[1, 4, 6, 10]] = rng.uniform(0, 320, size=(4, 20, 2))  # a third of the views saw something else
    wrong[0, :3] += 60
    wrong[8, 5] -= 90
    result = robust_triangulation(projections, wrong, 8.0)
    assert result is not None
    np.testing.assert_array_equal(np.flatnonzero(~result.agreeing), [1, 4, 6, 10])
    np.testing.assert_allclose(result.points, points, atol=1e-9)
    again = robust_triangulation(projections, wrong, 8.0)
    np.testing.assert_array_equal(again.points, result.points)


def test_views_that_agree_on_nothing_are_few(seen, rng):
    projections, pixels, _ = seen
    result = robust_triangulation(projections, rng.uniform(0, 320, size=pixels.shape), 4.0)
    assert result is None or result.agreeing.sum() <= 3


def test_too_little_to_triangulate(seen):
    projections, pixels, _ = seen
    assert robust_triangulation(projections[:1], pixels[:1], 8.0) is None
    same_centre = np.stack([projections[0], projections[0]])
    assert np.isnan(triangulate(same_centre, pixels[[0, 0]])).all()
    assert robust_triangulation(same_centre, pixels[[0, 0]], 8.0) is None
