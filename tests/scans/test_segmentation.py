import numpy as np
import pytest

from corporeal.scans.scan import Scan, Unit
from corporeal.scans.segmentation import crop_halfspace, object_mask, remove_object


def scan_of(points: np.ndarray, colours: np.ndarray | None) -> Scan:
    faces = np.zeros((0, 3), dtype=np.int64)
    return Scan("s", points, faces, np.zeros_like(points), colours, Unit("m", 1.0))


def test_rule_of_the_paper_at_its_edges():
    colours = np.array(
        [[0, 20, 0], [0, 21, 0], [99, 100, 255], [100, 100, 0], [255, 255, 255]], dtype=np.uint8
    )
    np.testing.assert_array_equal(object_mask(colours), [False, True, True, False, False])


def test_rule_of_the_paper_on_all_greens_and_reds():
    red, green = np.meshgrid(np.arange(256), np.arange(256), indexing="ij")
    colours = np.stack([red, green, 0 * red], axis=-1).reshape(-1, 3).astype(np.uint8)
    # 8-bit arithmetic must not wrap: compare in wide integers.
    np.testing.assert_array_equal(object_mask(colours), (green > np.where(red > 20, red, 20)).ravel())


def test_object_is_removed_and_stated(rng):
    points = rng.normal(size=(10, 3))
    colours = np.full((10, 3), 120, dtype=np.uint8)
    colours[:4, 1] = 200
    left = remove_object(scan_of(points, colours))
    np.testing.assert_array_equal(left.points, points[4:])
    assert "dropped: 4." in left.repairs[-1]
    plain = scan_of(points, np.full((10, 3), 120, dtype=np.uint8))
    assert remove_object(plain) is plain
    with pytest.raises(ValueError, match="no colours"):
        remove_object(scan_of(points, None))
    with pytest.raises(ValueError, match="every point is green"):
        remove_object(scan_of(points, np.tile(np.array([0, 255, 0], dtype=np.uint8), (10, 1))))


def test_halfspace_keeps_the_side_of_the_normal(rng):
    points = rng.normal(size=(200, 3))
    point, normal = rng.normal(size=3) * 0.1, 3.7 * rng.normal(size=3)
    near = crop_halfspace(scan_of(points, None), point, normal)
    far = crop_halfspace(scan_of(points, None), point, -normal)
    assert ((near.points - point) @ normal >= 0).all()
    assert ((far.points - point) @ normal <= 0).all()
    assert len(near.points) + len(far.points) == 200
    assert "beyond a plane" in near.repairs[-1]
    with pytest.raises(ValueError, match="non-zero"):
        crop_halfspace(near, point, np.zeros(3))
    with pytest.raises(ValueError, match="no point"):
        crop_halfspace(near, point + 100 * normal, normal)
