import numpy as np
import pytest

from corporeal.scans.files import read_scan
from corporeal.scans.point_normals import point_normals


def sphere(rng, count: int, radius: float = 1.0) -> np.ndarray:
    points = rng.normal(size=(count, 3))
    return radius * points / np.linalg.norm(points, axis=1, keepdims=True)


def test_sphere_points_outward_everywhere(rng):
    points = sphere(rng, 4000)
    cosine = np.einsum("ni,ni->n", point_normals(points), points)
    assert cosine.min() > 0.97


def test_normals_are_of_unit_length_and_turn_with_the_points(rng):
    points = sphere(rng, 500) * [1.0, 2.0, 0.5]
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    rotation *= np.linalg.det(rotation)
    normals = point_normals(points)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-12)
    np.testing.assert_allclose(point_normals(7 * points @ rotation.T + 3), normals @ rotation.T, atol=1e-6)


def test_parts_are_turned_outward_one_by_one(rng):
    points = np.concatenate([sphere(rng, 1000), sphere(rng, 1000) + [9.0, 0, 0]])
    centres = np.repeat([[0.0, 0, 0], [9.0, 0, 0]], 1000, axis=0)
    assert (np.einsum("ni,ni->n", point_normals(points), points - centres) > 0.9).all()


def test_close_opposite_sheets_keep_their_own_sides(rng):
    # Two fingers side by side: spheres of radius 1 whose gap (0.05) is less than the spacing of the points.
    points = np.concatenate([sphere(rng, 3000), sphere(rng, 3000) + [2.05, 0, 0]])
    centres = np.repeat([[0.0, 0, 0], [2.05, 0, 0]], 3000, axis=0)
    cosine = np.einsum("ni,ni->n", point_normals(points), points - centres)
    assert (cosine > 0).mean() > 0.995


def test_too_few_points_are_refused(rng):
    with pytest.raises(ValueError, match="more than 12"):
        point_normals(rng.normal(size=(12, 3)))


@pytest.mark.real_data
@pytest.mark.parametrize(("name", "step"), [("hand-scan2knit/hand5.off", 1), ("hand-sense/hand3.stl", 8)])
def test_real_hand_agrees_with_its_mesh(shared_data, name, step):
    scan = read_scan(shared_data / "scans" / name)
    cosine = np.einsum("ni,ni->n", point_normals(scan.points[::step]), scan.normals[::step])
    assert (cosine > 0).mean() > 0.995
    assert (cosine > 0.9).mean() > 0.93
