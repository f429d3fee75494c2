import time

import numpy as np
import pytest
from scipy.spatial import cKDTree

from corporeal.scans.sampling import sample_points


def uneven_sphere(rng, count: int) -> np.ndarray:
    """Points on a sphere, twenty times denser on one half."""
    points = rng.normal(size=(40 * count, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    dense = points[points[:, 0] > 0][: count - count // 21]
    return np.concatenate([dense, points[points[:, 0] <= 0][: count // 21]])


@pytest.mark.parametrize("count", [1, 10, 400, 3000])
def test_gives_exactly_so_many_different_points(rng, count):
    chosen = sample_points(uneven_sphere(rng, 20000), count, seed=3)
    assert len(chosen) == count
    assert (np.diff(chosen) > 0).all()


def test_is_even_in_area_where_the_scan_is_not(rng):
    points = uneven_sphere(rng, 20000)
    chosen = points[sample_points(points, 500)]
    # 95 % of the points lie on one half; a grid takes a few more there, where no cube stays empty.
    assert abs((chosen[:, 0] > 0).mean() - 0.5) < 0.12
    # No holes: every scan point is near a sample. Drawing 500 points at random instead leaves holes of 0.6.
    farthest = cKDTree(chosen).query(points)[0].max()
    at_random = cKDTree(rng.choice(points, 500, replace=False)).query(points)[0].max()
    assert farthest < min(0.25, 0.5 * at_random)


def test_is_deterministic_and_follows_the_seed(rng):
    points = uneven_sphere(rng, 5000)
    np.testing.assert_array_equal(sample_points(points, 300, 1), sample_points(points, 300, 1))
    assert (sample_points(points, 300, 1) != sample_points(points, 300, 2)).any()


def test_does_not_depend_on_unit(rng):
    points = uneven_sphere(rng, 5000)
    np.testing.assert_array_equal(sample_points(points, 300), sample_points(1024.0 * points, 300))


@pytest.mark.parametrize("flat", [1, 2])
def test_lines_planes_and_equal_points(rng, flat):
    points = rng.uniform(size=(3000, 3))
    points[:, flat:] = 0.5
    assert len(np.unique(sample_points(points, 100))) == 100
    assert len(np.unique(sample_points(np.zeros((3000, 3)), 100))) == 100


def test_few_points_are_all_taken(rng):
    np.testing.assert_array_equal(sample_points(rng.normal(size=(5, 3)), 9), np.arange(5))
    with pytest.raises(ValueError, match="count"):
        sample_points(rng.normal(size=(5, 3)), 0)


def test_is_fast_enough_for_a_coarse_stage(rng):
    points = uneven_sphere(rng, 50000)
    seconds = []
    for _ in range(5):
        begin = time.perf_counter()
        sample_points(points, 2000)
        seconds.append(time.perf_counter() - begin)
    assert min(seconds) < 0.05  # measured 0.006 s; the bound has room for a busy machine
