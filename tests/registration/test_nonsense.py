"""What is no hand, and what is no model, must not pass for a registration."""

import dataclasses

import numpy as np
import pytest
import scipy.sparse as sp
import trimesh

from corporeal.geometry.normals import vertex_normals
from corporeal.model.jacobian import evaluate
from corporeal.model.landmarks import LandmarkSet
from corporeal.registration.evidence import LandmarkEvidence, LandmarkFinder
from corporeal.registration.judgement import Bounds
from corporeal.registration.options import RegistrationOptions
from corporeal.registration.register import model_of_side, register
from corporeal.registration.rows import registered_row
from corporeal.scans.files import read_scan
from corporeal.scans.scan import Scan, Unit


def mesh_scan(name, mesh):
    points, faces = np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.int64)
    return Scan(name, points, faces, vertex_normals(points, faces), None, Unit("mm", 1e-3))


SHAPES = {
    "ball": lambda: trimesh.creation.icosphere(4, radius=0.04),
    "head": lambda: trimesh.creation.icosphere(4, radius=0.09),
    "box": lambda: trimesh.creation.box((0.18, 0.09, 0.03)).subdivide_to_size(0.006),
}


ONCE = dataclasses.replace(RegistrationOptions.for_sessions(), second_starts=0, bounds=Bounds())


def resting_landmarks(model):
    """As if a detector had seen a flat hand in the middle of the scan: quicker than a search, and no help."""
    landmark_set = model.landmarks["hand_21_mediapipe"]
    posed = evaluate(model, np.zeros(1), np.zeros((model.joint_count, 3)), np.zeros(3))
    marks = landmark_set.positions(posed.vertices, posed.joints)
    marks = marks - marks.mean(axis=0)
    return LandmarkEvidence(dict(zip(landmark_set.names, marks, strict=True)), {}, 0.99, "hand_21_mediapipe")


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.slow
def test_other_things_fail(hand, name):
    result = register(mesh_scan(name, SHAPES[name]()), hand, resting_landmarks(hand), "right", ONCE)
    assert result.status == "failed", result.reason


@pytest.mark.slow
def test_a_nonsense_model_fails(hand, make_capture, rng):
    count = 778
    landmark_set = hand.landmarks["hand_21_mediapipe"]
    kept = np.concatenate([np.arange(count), np.arange(hand.vertex_count, landmark_set.weights.shape[1])])
    weights = landmark_set.weights[:, kept].toarray() + 1e-9
    weights = sp.csr_matrix(weights / weights.sum(axis=1, keepdims=True))
    nonsense = dataclasses.replace(
        hand,
        template=0.05 * rng.standard_normal((count, 3)),
        faces=np.array([rng.choice(count, 3, replace=False) for _ in range(1538)]),
        shape_directions=hand.shape_directions[:count],
        joint_regressor=hand.joint_regressor[:, :count],
        skinning_weights=hand.skinning_weights[:count],
        expression_directions=hand.expression_directions[:count],
        pose_directions=hand.pose_directions[:count],
        landmarks={"hand_21_mediapipe": LandmarkSet(landmark_set.names, weights, count)},
        parts={},
        cut=None,
    )
    capture = make_capture(hand, 22)
    result = register(capture.scan, nonsense, capture.evidence, options=ONCE)
    assert result.status == "failed", result.reason


def test_a_side_cannot_be_asked_of_a_model_without_one(hand, make_capture):
    sideless = dataclasses.replace(hand, side=None)
    assert model_of_side(sideless, None) is sideless
    with pytest.raises(ValueError, match="leave --side out"):
        model_of_side(sideless, "left")
    capture = make_capture(hand, 23)
    result = register(capture.scan, sideless, capture.evidence, "right")
    assert result.side is None
    assert any("has no side" in note for note in registered_row("x", result, {}, [])["notes"])


@pytest.mark.real_data
def test_a_real_hand(hand, shared_data):
    scan = read_scan(shared_data / "scans" / "hand-scan2knit" / "hand5.off")
    with LandmarkFinder(hand) as finder:
        evidence, _ = finder.find(scan)
    result = register(scan, hand, evidence)
    assert (result.status, result.side) == ("ok", "right"), result.reason
    assert result.distances.summary_mm()["mean"] < 0.3 and result.distances.scored_share > 0.95
    assert result.model_distances.summary_mm()["mean"] < 1.5
    assert result.signals["far_share"] < 0.01 and result.signals["penetration_mm"] < 1.0
    assert not result.notes


def test_a_row_says_when_the_model_was_mirrored(hand, make_capture):
    capture = make_capture(hand, 5)
    flip = np.array([-1.0, 1, 1])
    scan = dataclasses.replace(
        capture.scan,
        points=capture.scan.points * flip,
        normals=capture.scan.normals * flip,
        faces=np.ascontiguousarray(capture.scan.faces[:, ::-1]),
    )
    marks = {name: point * flip for name, point in capture.evidence.positions.items()}
    evidence = dataclasses.replace(capture.evidence, positions=marks, right_probability=0.01)
    result = register(scan, hand, evidence, options=ONCE)
    assert registered_row("x", result, {}, [])["notes"] == ["the right model was mirrored to a left one"]
