"""Distances back to the scan: asked of the body and of hands that are seen, not of a missing one."""

import numpy as np
import pytest

from corporeal.fitting.frame_data import FramePoints
from corporeal.fitting.frame_fit import FrameFitter, FrameStart, scan_surface
from corporeal.fitting.options import AnnealingStep, TrackingOptions
from corporeal.fitting.subject_template import personal_model
from corporeal.geometry.normals import face_areas, face_normals, vertex_normals
from corporeal.model.files import open_model
from corporeal.model.jacobian import evaluate
from corporeal.scans.scan import Scan, Unit

OPTIONS = TrackingOptions(hand_back=0.3)
WIDE, NARROW = AnnealingStep(100.0, 0.1, 4), AnnealingStep(500.0, 0.01, 5)


@pytest.fixture(scope="module")
def fitter():
    body = open_model("body")
    return FrameFitter(personal_model(body, body.template), OPTIONS)


@pytest.fixture
def without_left_hand(fitter):
    return _without(fitter, fitter.hands.masks["left_hand"])


def _without(fitter, lost):
    """A body with hanging arms, points on all of it but the lost faces, and its surface likewise."""
    body = fitter.model
    pose = np.zeros((body.joint_count, 3))
    pose[body.joint_names.index("left_shoulder"), 2] = -1.2
    pose[body.joint_names.index("right_shoulder"), 2] = 1.2
    vertices = evaluate(body, np.zeros(0), pose, np.zeros(3)).vertices
    seen = body.faces[~lost]
    corners = vertices[seen]
    points = FramePoints(
        corners.mean(axis=1), face_normals(vertices, seen), face_areas(vertices, seen).mean()
    )
    used, faces = np.unique(seen, return_inverse=True)
    faces = faces.reshape(-1, 3).astype(np.int64)
    scan = Scan("in part", vertices[used], faces, vertex_normals(vertices[used], faces), None, Unit("m", 1.0))
    return fitter, points, scan, np.concatenate([np.zeros(3), pose.ravel()])


def _weights(shown, step, *, first):
    """Weights of the two terms together; of the arms' vertices among them."""
    fitter, points, scan, vector = shown
    previous = None if first else vector[3:].reshape(-1, 3)
    start = FrameStart(vector, previous, first=first, back=scan_surface(scan))
    terms = [term for term in fitter._terms(points, vector, start, step) if "back" in term.name]
    if not terms:
        return None
    weights = sum(term.weights for term in terms)
    assert not np.logical_and(*(term.weights > 0 for term in terms)).any()
    hands = {name: np.unique(fitter.model.faces[mask]) for name, mask in fitter.hands.masks.items()}
    return weights, hands, fitter.model


@pytest.mark.parametrize("forearm", [False, True], ids=["hand", "hand and forearm"])
def test_a_missing_hand_is_not_asked_nor_a_forearm_that_is_missing_too(fitter, forearm):
    lost = fitter.hands.masks["left_hand"] | (forearm & fitter.hands.forearms["left_forearm"])
    weights, hands, model = _weights(_without(fitter, lost), NARROW, first=False)
    assert (weights[hands["left_hand"]] == 0).all() and (weights[hands["right_hand"]] > 0).all()
    for side, asked in (("left", not forearm), ("right", True)):
        own = model.skinning_weights[:, model.joint_names.index(f"{side}_elbow")] > 0.6
        assert ((weights[own] > 0) == asked).all()
    torso = model.skinning_weights[:, model.joint_names.index("spine2")] > 0.6
    np.testing.assert_allclose(weights[hands["right_hand"]], OPTIONS.hand_back * weights[torso].mean())


def test_nothing_is_asked_from_afar(without_left_hand):
    assert _weights(without_left_hand, WIDE, first=False) is None


def test_all_of_the_first_frame_is_asked(without_left_hand):
    assert (_weights(without_left_hand, WIDE, first=True)[0] > 0).all()
