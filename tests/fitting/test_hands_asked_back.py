"""Distances from hands back to the scan: asked of hands that are seen, not of missing ones beside a thigh."""

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

WIDE, NARROW = AnnealingStep(100.0, 0.1, 4), AnnealingStep(500.0, 0.01, 5)


@pytest.fixture(scope="module")
def without_left_hand():
    """A body with hanging arms, points on all of it but the left hand, and its surface likewise."""
    body = open_model("body")
    personal = personal_model(body, body.template)
    fitter = FrameFitter(personal, TrackingOptions())
    pose = np.zeros((body.joint_count, 3))
    pose[body.joint_names.index("left_shoulder"), 2] = -1.2
    pose[body.joint_names.index("right_shoulder"), 2] = 1.2
    vertices = evaluate(personal, np.zeros(0), pose, np.zeros(3)).vertices
    seen = body.faces[~fitter.hands.masks["left_hand"]]
    corners = vertices[seen]
    points = FramePoints(
        corners.mean(axis=1), face_normals(vertices, seen), face_areas(vertices, seen).mean()
    )
    used, faces = np.unique(seen, return_inverse=True)
    faces = faces.reshape(-1, 3).astype(np.int64)
    scan = Scan("no hand", vertices[used], faces, vertex_normals(vertices[used], faces), None, Unit("m", 1.0))
    return fitter, points, scan, np.concatenate([np.zeros(3), pose.ravel()])


def _weights(without_left_hand, step, *, first):
    fitter, points, scan, vector = without_left_hand
    start = FrameStart(vector, None, first=first, back=scan_surface(scan))
    (back,) = [term for term in fitter._terms(points, vector, start, step) if term.name == "back"]
    of = {
        name: back.weights[np.unique(fitter.model.faces[mask])] for name, mask in fitter.hands.masks.items()
    }
    return back.weights, of["left_hand"], of["right_hand"]


def test_a_missing_hand_is_not_asked(without_left_hand):
    weights, left, right = _weights(without_left_hand, NARROW, first=False)
    assert (left == 0).all() and (right > 0).all()
    assert (weights > 0).sum() == len(right)


def test_no_hand_is_asked_from_afar(without_left_hand):
    assert (_weights(without_left_hand, WIDE, first=False)[0] == 0).all()


def test_all_of_the_first_frame_is_asked(without_left_hand):
    assert (_weights(without_left_hand, WIDE, first=True)[0] > 0).all()
