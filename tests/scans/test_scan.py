import numpy as np
import pytest

from corporeal.scans.scan import Scan, Unit


@pytest.fixture
def scan(rng) -> Scan:
    points = rng.normal(size=(6, 3))
    normals = points / np.linalg.norm(points, axis=1, keepdims=True)
    faces = np.array([[0, 1, 2], [1, 2, 3], [3, 4, 5]])
    colours = rng.integers(0, 256, size=(6, 3)).astype(np.uint8)
    return Scan("a", points, faces, normals, colours, Unit("mm", 0.001), "a.ply", ("welded.",))


def test_own_unit_is_the_inverse_of_the_reading_scale(scan):
    np.testing.assert_allclose(scan.in_own_unit(scan.points), 1000 * scan.points, rtol=1e-15)


def test_with_scale_reads_the_same_file_in_another_scale(scan):
    other = scan.with_scale(0.0208)
    np.testing.assert_allclose(other.in_own_unit(other.points), scan.in_own_unit(scan.points), rtol=1e-14)
    assert other.unit == Unit("free", 0.0208)
    assert other.diagonal == pytest.approx(20.8 * scan.diagonal, rel=1e-14)


def test_subset_keeps_whole_faces_and_their_corners(scan):
    mask = np.array([False, True, True, True, True, False])
    part = scan.subset(mask)
    np.testing.assert_array_equal(part.points, scan.points[mask])
    np.testing.assert_array_equal(part.normals, scan.normals[mask])
    np.testing.assert_array_equal(part.colours, scan.colours[mask])
    np.testing.assert_array_equal(part.points[part.faces], scan.points[scan.faces[[1]]])
    assert part.repairs == scan.repairs
    with pytest.raises(ValueError, match="no point"):
        scan.subset(np.zeros(6, dtype=bool))


def test_repairs_are_appended(scan):
    assert scan.with_repair("more.").repairs == ("welded.", "more.")


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("points", np.full((6, 3), np.nan), "finite"),
        ("faces", np.array([[0, 1, 6]]), "faces: expected indices from 0 to 5"),
        ("faces", np.array([[0, 1, -1]]), "faces: expected indices"),
    ],
)
def test_wrong_records_are_refused(scan, field, value, message):
    fields = {name: getattr(scan, name) for name in ("name", "points", "faces", "normals", "colours", "unit")}
    with pytest.raises(ValueError, match=message):
        Scan(**{**fields, field: value})


@pytest.mark.parametrize("scale", [0.0, -1.0, float("nan"), float("inf")])
def test_a_unit_is_a_positive_length(scale):
    with pytest.raises(ValueError, match="metres_per_unit"):
        Unit("free", scale)
