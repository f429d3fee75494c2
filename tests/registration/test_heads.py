"""Heads from scan to registration, landmarks found by virtual views."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from corporeal.geometry.normals import vertex_normals
from corporeal.model.files import open_model
from corporeal.model.jacobian import evaluate
from corporeal.registration.evidence import LandmarkFinder
from corporeal.registration.options import RegistrationOptions
from corporeal.registration.register import register
from corporeal.registration.starts import turned
from corporeal.registration.subjects import HEAD
from corporeal.scans.face_detector import FACE_NAMES, FaceDetector
from corporeal.scans.face_landmarks import find_face_landmarks
from corporeal.scans.files import read_scan
from corporeal.scans.scan import Scan, Unit


class BlindDetector(FaceDetector):
    """Looks at pictures and sees nothing; needs no network."""

    def __init__(self):
        self.pictures = 0

    def detect(self, picture):
        self.pictures += 1


@pytest.fixture(scope="module")
def head():
    return open_model("head")


@pytest.fixture(scope="module")
def finder(head):
    pytest.importorskip("mediapipe")
    with LandmarkFinder(head) as loaded:
        yield loaded


def test_names_are_those_of_the_models_set(head):
    assert head.landmarks["face"].names == FACE_NAMES


def test_a_scan_without_a_face_is_said_to_have_none(head):
    normals = vertex_normals(head.template, head.faces)
    scan = Scan("head", head.template, head.faces, normals, None, Unit("m", 1.0))
    blind = BlindDetector()
    found = find_face_landmarks(scan, blind)
    assert not found.ok and "saw no face" in found.reason
    assert found.views_tried == blind.pictures == 8 * 12


@pytest.mark.slow
def test_a_face_of_the_model_is_found_wherever_it_looks(head, finder):
    shape = 0.8 * np.random.default_rng(2).normal(size=head.shape_count)
    shape[25:] *= 0.3
    lying = Rotation.from_euler("xz", [-90, 40], degrees=True).as_matrix()
    for R in (np.eye(3), lying):
        vector = turned(head, np.zeros((5, 3)), shape, R, np.array([0.3, 1.2, -0.4]))
        posed = evaluate(head, shape, vector[3:18].reshape(-1, 3), vector[:3])
        rng = np.random.default_rng(5)
        points = posed.vertices + rng.normal(scale=0.2e-3, size=posed.vertices.shape)
        normals = vertex_normals(points, head.faces)
        scan = Scan("head", points, head.faces, normals, None, Unit("m", 1.0))
        evidence, _ = finder.find(scan)
        result = register(scan, head, evidence, None, RegistrationOptions.for_heads())
        assert result.status == "ok", result.reason
        error = np.linalg.norm(result.vertices - posed.vertices, axis=1)
        assert np.median(error) < 0.5e-3 and error.mean() < 1.0e-3


@pytest.mark.slow
@pytest.mark.real_data
def test_a_real_bust_without_a_unit_is_registered_in_any_direction(shared_data, head, finder):
    scan = read_scan(shared_data / "scans" / "head-leeperry" / "LeePerrySmith.glb", "free", HEAD.extent)
    R = Rotation.from_euler("xyz", [95, 10, 70], degrees=True).as_matrix()
    other = Scan("turned", scan.points @ R.T, scan.faces, scan.normals @ R.T, None, scan.unit)
    means = []
    for given in (scan, other):
        evidence, notes = finder.find(given)
        assert evidence is not None, notes
        result = register(given, head, evidence, None, RegistrationOptions.for_heads())
        assert result.status == "ok", result.reason
        means.append(result.distances.summary_mm()["mean"])
        # A head is as high as heads are, once the scale is estimated.
        height = np.ptp(result.vertices @ (R.T if given is other else np.eye(3)).T, axis=0)[1]
        assert 0.24 < height < 0.36
    assert max(means) < 2.5 and abs(means[0] - means[1]) < 0.3


def test_the_detector_sees_no_face_in_plain_colour():
    pytest.importorskip("mediapipe")
    with FaceDetector() as detector:
        assert detector.detect(np.full((200, 200, 3), 90, np.uint8)) is None
