"""Registration of captures whose truth is known, and the ways in which it must not care how a scan lies."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from corporeal.model.mirror import mirror_model
from corporeal.registration.evidence import LandmarkEvidence
from corporeal.registration.register import register
from corporeal.registration.registration import FailedRegistration
from corporeal.scans.scan import Unit


def _v2v_mm(registration, truth):
    return 1e3 * np.linalg.norm(registration.vertices - truth, axis=1)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_known_captures_are_recovered(hand, make_capture, seed):
    capture = make_capture(hand, seed)
    result = register(capture.scan, hand, capture.evidence)
    assert result.status in ("ok", "doubtful"), result.reason
    assert result.side == "right"
    assert result.distances.summary_mm()["mean"] < 0.25
    assert _v2v_mm(result, capture.vertices).mean() < 1.0
    joints = hand.landmarks["hand_21_mediapipe"]
    assert result.distances.scored_share > 0.9
    assert set(joints.names) <= set(result.landmarks)


def test_a_moved_scan_gives_the_moved_registration(hand, make_capture):
    capture = make_capture(hand, 4)
    R, t = Rotation.from_rotvec([2.0, -1.0, 1.5]).as_matrix(), np.array([0.3, -0.2, 0.5])
    moved = dataclasses.replace(
        capture.scan, points=capture.scan.points @ R.T + t, normals=capture.scan.normals @ R.T
    )
    marks = {name: R @ point + t for name, point in capture.evidence.positions.items()}
    first = register(capture.scan, hand, capture.evidence)
    second = register(moved, hand, dataclasses.replace(capture.evidence, positions=marks))
    back = (second.vertices - t) @ R
    assert 1e3 * np.linalg.norm(back - first.vertices, axis=1).mean() < 0.5


def test_a_mirrored_scan_becomes_a_left_hand(hand, make_capture):
    capture = make_capture(hand, 5)
    flip = np.array([-1.0, 1, 1])
    scan = dataclasses.replace(
        capture.scan,
        points=capture.scan.points * flip,
        normals=capture.scan.normals * flip,
        faces=np.ascontiguousarray(capture.scan.faces[:, ::-1]),
    )
    marks = {name: point * flip for name, point in capture.evidence.positions.items()}
    evidence = LandmarkEvidence(marks, {}, 0.01, capture.evidence.set_name)
    result = register(scan, hand, evidence)
    assert result.side == "left"
    assert _v2v_mm(result, capture.vertices * flip).mean() < 1.0
    # The left model given directly ends at the same place: which side the file holds does not matter.
    again = register(scan, mirror_model(hand), evidence)
    assert np.abs(again.vertices - result.vertices).max() < 1e-9


def test_undecided_labels_are_decided_by_the_surface(hand, make_capture):
    capture = make_capture(hand, 6, right_probability=0.4)
    assert register(capture.scan, hand, capture.evidence).side == "right"


@pytest.mark.parametrize("seed", [11, 13, 16, 18])
def test_a_scan_without_a_unit_gets_the_scale_of_an_average_hand(hand, make_capture, seed):
    capture = make_capture(hand, seed, shape_spread=0.0, bend=0.8)
    scale = 20.8
    unitless = dataclasses.replace(capture.scan, points=capture.scan.points * scale, unit=Unit("free", 1.0))
    marks = {name: scale * point for name, point in capture.evidence.positions.items()}
    result = register(unitless, hand, dataclasses.replace(capture.evidence, positions=marks))
    assert result.scan.unit.name == "free"
    assert 1 / result.scan.unit.metres_per_unit == pytest.approx(scale, rel=0.04)
    own = result.scan.in_own_unit(result.vertices) / scale
    assert 1e3 * np.linalg.norm(own - capture.vertices, axis=1).mean() < 1.5


@pytest.mark.slow
def test_without_unit_and_landmarks_scale_and_orientation_are_searched(hand, make_capture):
    capture = make_capture(hand, 14, shape_spread=0.0)
    provisional = 1.2 / 20.8
    unitless = dataclasses.replace(
        capture.scan, points=capture.scan.points * 20.8 * provisional, unit=Unit("free", provisional)
    )
    result = register(unitless, hand, None, "right")
    assert 1 / result.scan.unit.metres_per_unit == pytest.approx(20.8, rel=0.06)


@pytest.mark.slow
def test_without_landmarks_the_orientation_is_searched(hand, make_capture):
    capture = make_capture(hand, 8)
    result = register(capture.scan, hand, None)
    assert result.side == "right"
    assert result.distances.summary_mm()["mean"] < 0.4
    assert _v2v_mm(result, capture.vertices).mean() < 1.5


@pytest.mark.slow
def test_a_scan_of_something_else_is_not_called_ok(hand, rng):
    from corporeal.scans.scan import Scan

    points = rng.normal(size=(3000, 3))
    points = 0.08 * points / np.linalg.norm(points, axis=1, keepdims=True)
    ball = Scan("ball", points, np.zeros((0, 3), np.int64), points / 0.08, None, Unit("m", 1.0))
    result = register(ball, hand, None, "right")
    assert isinstance(result, FailedRegistration) or result.status != "ok"


def test_the_same_scan_gives_the_same_bytes(hand, make_capture):
    capture = make_capture(hand, 9)
    first, second = (register(capture.scan, hand, capture.evidence) for _ in range(2))
    assert np.array_equal(first.vertices, second.vertices)
