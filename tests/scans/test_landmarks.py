import dataclasses
import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from corporeal.geometry.cameras import Pinhole
from corporeal.scans.detector import LANDMARK_NAMES, DetectedHand, DetectorMissingError, HandDetector
from corporeal.scans.files import read_scan
from corporeal.scans.landmarks import find_hand_landmarks
from corporeal.scans.scan import Scan, Unit
from corporeal.scans.virtual_cameras import Subject


class FakeDetector(HandDetector):
    """Sees the given world points exactly; a share of its views is nonsense, and a share sees nothing."""

    def __init__(self, points, rng, *, right=0.9, nonsense=0.0, blind=0.0):
        self.points, self.rng, self.right = points, rng, right
        self.nonsense, self.blind = nonsense, blind

    def detect(self, picture: Pinhole) -> DetectedHand | None:
        kind = self.rng.uniform()
        if kind < self.blind:
            return None
        pixels, _ = picture.project(self.points)
        if kind < self.blind + self.nonsense:
            pixels = self.rng.uniform(0, picture.height, size=(21, 2))
        return DetectedHand(pixels, self.right, max(self.right, 1 - self.right))

    def followed(self, pictures):
        return [self.detect(picture) for picture in pictures]


@pytest.fixture
def capture(rng, monkeypatch):
    """A long cloud with a hand-sized set of landmarks at one end; pictures are the cameras themselves."""
    monkeypatch.setattr(Subject, "picture", lambda self, camera: camera)
    turn = Rotation.random(random_state=3).as_matrix()
    cloud = rng.uniform([-0.2, -0.03, -0.02], [0.2, 0.03, 0.02], size=(500, 3)) @ turn.T + 0.7
    marks = rng.uniform([0.04, -0.03, -0.02], [0.2, 0.03, 0.02], size=(21, 3)) @ turn.T + 0.7
    marks[0] = turn @ [0.02, 0, 0] + 0.7
    marks[9] = turn @ [0.12, 0.001, 0] + 0.7
    marks[[5, 17]] = np.array([[0.11, 0.03, 0.0], [0.11, -0.03, 0.0]]) @ turn.T + 0.7
    scan = Scan("x", cloud, np.zeros((0, 3), np.int64), np.zeros((500, 3)), None, Unit("m", 1.0))
    return scan, marks


def test_what_all_views_see_is_found_exactly(capture, rng):
    scan, marks = capture
    found = find_hand_landmarks(scan, FakeDetector(marks, rng))
    assert found.ok and found.names == LANDMARK_NAMES
    np.testing.assert_allclose(found.points, marks, atol=1e-10)
    assert found.side_score == pytest.approx(0.9)
    assert found.spread_m.max() < 1e-10 and found.reprojection_px < 1e-6
    assert 0 < found.views_used < found.views_tried  # the coarse views are tried, not used


def test_a_third_of_nonsense_does_not_matter(capture, rng):
    scan, marks = capture
    found = find_hand_landmarks(scan, FakeDetector(marks, rng, nonsense=0.35, blind=0.2))
    assert found.ok
    np.testing.assert_allclose(found.points, marks, atol=1e-8)


@pytest.mark.parametrize(
    ("share", "reason"),
    [({"blind": 1.0}, r"saw no hand.*0 of 24"), ({"nonsense": 1.0}, "agree")],
)
def test_views_that_do_not_agree_are_refused_with_a_reason(capture, rng, share, reason):
    scan, marks = capture
    found = find_hand_landmarks(scan, FakeDetector(marks, rng, **share))
    assert not found.ok
    assert np.isnan(found.points).all()
    assert re.search(reason, found.reason)


def test_a_mesh_that_few_views_show_is_looked_at_again_without_its_noise(capture, rng, monkeypatch):
    scan, marks = capture
    mesh = dataclasses.replace(scan, faces=np.array([[0, 1, 2]]))
    smoothed = []
    monkeypatch.setattr(Subject, "smoothed", lambda self: smoothed.append(self) or self)
    assert find_hand_landmarks(mesh, FakeDetector(marks, rng)).views_tried == 14
    assert not smoothed
    # Where a part of the views is no use, more are taken before the noise is blamed.
    assert find_hand_landmarks(mesh, FakeDetector(marks, rng, blind=0.5)).views_tried > 14
    assert not smoothed
    blind = FakeDetector(marks, rng, blind=1.0)
    assert not find_hand_landmarks(mesh, blind).ok and len(smoothed) == 1
    assert not find_hand_landmarks(scan, blind).ok and len(smoothed) == 1  # a cloud has no other picture


@pytest.fixture(scope="module")
def detector():
    try:
        with HandDetector() as loaded:
            yield loaded
    except DetectorMissingError as error:
        pytest.skip(str(error))


def turned_cloud(scan: Scan, transform: np.ndarray) -> Scan:
    points = np.ascontiguousarray(scan.points @ transform.T)
    normals = np.ascontiguousarray(scan.normals @ transform.T)
    return Scan(scan.name, points, np.zeros((0, 3), np.int64), normals, None, scan.unit)


@pytest.mark.slow
@pytest.mark.real_data
def test_a_real_right_hand_is_found_turned_mirrored_and_as_points(shared_data, detector):
    scan = read_scan(shared_data / "scans" / "hand-scan2knit" / "hand5.off")
    found = find_hand_landmarks(scan, detector)
    assert found.ok and found.side_score > 0.8 and found.views_used >= 7
    nearest = np.linalg.norm(scan.points[None] - found.points[:, None], axis=2).min(1)
    assert nearest.max() < 0.03
    lengths = np.linalg.norm(found.points[[8, 12, 16, 20]] - found.points[[5, 9, 13, 17]], axis=1)
    assert (lengths > 0.05).all() and (lengths < 0.12).all()

    mirror = Rotation.random(random_state=4).as_matrix() @ np.diag([-1.0, 1, 1])
    other = find_hand_landmarks(turned_cloud(scan, mirror), detector)
    assert other.ok and other.side_score < 0.2
    error = np.linalg.norm(other.points @ mirror - found.points, axis=1)
    assert np.median(error) < 0.003 and error.max() < 0.015


@pytest.mark.slow
@pytest.mark.real_data
def test_answers_do_not_depend_on_what_was_asked_before(shared_data, detector):
    """Hands are followed from view to view, but not from scan to scan."""
    scan = read_scan(shared_data / "scans" / "hand-scan2knit" / "hand5.off")
    alone = find_hand_landmarks(scan)
    find_hand_landmarks(read_scan(shared_data / "scans" / "hand-sense" / "hand3.stl"), detector)
    again = find_hand_landmarks(scan, detector)
    np.testing.assert_array_equal(again.points, alone.points)
    assert (again.side_score, again.views_used) == (alone.side_score, alone.views_used)


@pytest.mark.slow
@pytest.mark.real_data
def test_a_left_hand_on_a_long_arm_is_found(shared_data, detector):
    scan = read_scan(shared_data / "scans" / "hand-sense" / "hand3.stl")
    found = find_hand_landmarks(scan, detector)
    assert found.ok and found.side_score < 0.4
    assert 0.06 < np.linalg.norm(found.points[9] - found.points[0]) < 0.12
