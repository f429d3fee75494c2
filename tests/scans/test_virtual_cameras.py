import dataclasses

import numpy as np
import pytest

from corporeal.scans.scan import Scan, Unit
from corporeal.scans.virtual_cameras import BACKGROUND, SKIN, Subject, cameras_around, ring


def ball(count: int, with_faces: bool) -> Scan:
    """A ball of 5 cm radius: points of a Fibonacci spiral, faces of their convex hull."""
    from scipy.spatial import ConvexHull

    height = 1 - 2 * (np.arange(count) + 0.5) / count
    turn = np.pi * (3 - np.sqrt(5)) * np.arange(count)
    across = np.sqrt(1 - height**2)
    points = 0.05 * np.stack([across * np.cos(turn), height, across * np.sin(turn)], axis=1)
    faces = ConvexHull(points).simplices.astype(np.int64) if with_faces else np.zeros((0, 3), np.int64)
    return Scan("ball", points, faces, points / 0.05, None, Unit("m", 1.0))


def test_a_ring_goes_evenly_round_its_axis(rng):
    axis = rng.normal(size=3)
    directions = ring(axis, 8, (0.0, 0.4))
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1)
    unit = axis / np.linalg.norm(axis)
    np.testing.assert_allclose(directions[:8] @ unit, 0, atol=1e-14)
    np.testing.assert_allclose(directions[8:] @ unit, np.sin(0.4))
    np.testing.assert_allclose(directions[:8].sum(0), 0, atol=1e-13)
    steps = np.einsum("ni,ni->n", directions[:8], np.roll(directions[:8], 1, axis=0))
    np.testing.assert_allclose(steps, np.cos(np.pi / 4))


@pytest.mark.parametrize("with_faces", [True, False])
def test_mesh_and_cloud_make_the_same_picture(with_faces):
    up, direction = np.array([0, 1.0, 0]), np.array([[0.3, 0.1, 1.0]])
    scan = ball(3000, with_faces)
    (camera,) = cameras_around(scan.points, direction, up, size=120, fill=0.6)
    picture = Subject.of_scan(scan).picture(camera).astype(float) / 255
    radius = np.hypot(*(np.mgrid[:120, :120] + 0.5 - 60))
    np.testing.assert_allclose(picture[radius > 39] - BACKGROUND, 0, atol=0.003)
    inside = radius < 35
    # Lambert under a headlight: cosine between normal and ray, for a ball seen from afar sqrt(1 - r^2 / R^2).
    expected = 0.25 + 0.75 * np.sqrt(1 - (radius[inside] / 36) ** 2)
    np.testing.assert_allclose(picture[inside], expected[:, None] * SKIN, atol=0.06)


def test_smoothing_takes_noise_off_and_does_not_shrink(rng):
    scan = ball(8000, True)
    noisy = dataclasses.replace(scan, points=scan.points + 3e-4 * rng.normal(size=scan.points.shape))
    smooth = Subject.of_scan(noisy).smoothed().scan.points

    def radii(points: np.ndarray) -> np.ndarray:
        return np.linalg.norm(points, axis=1)

    def steepness(points: np.ndarray) -> float:
        """Root mean square sine between faces and the ball they were on: what the shading shows."""
        a, b, c = (points[scan.faces[:, k]] for k in range(3))
        normals = np.cross(b - a, c - a)
        across = np.cross(normals, a + b + c)
        return float(np.sqrt(np.mean((radii(across) / radii(normals) / radii(a + b + c)) ** 2)))

    assert radii(smooth).std() < 0.6 * radii(noisy.points).std()
    assert steepness(smooth) < 0.5 * steepness(noisy.points)
    assert radii(smooth).mean() == pytest.approx(radii(noisy.points).mean(), abs=2e-5)
    lone = dataclasses.replace(
        scan, points=np.r_[scan.points, [[1.0, 2, 3]]], normals=np.r_[scan.normals, [[0.0, 0, 0]]]
    )
    np.testing.assert_array_equal(Subject.of_scan(lone).smoothed().scan.points[-1], [1, 2, 3])
    cloud = Subject.of_scan(ball(50, False))
    assert cloud.smoothed() is cloud
