"""A forearm that is missing stays where it was, and is found where it comes back."""

import numpy as np
import pytest

from corporeal.fitting.arm_search import ArmSearch
from corporeal.fitting.options import TrackingOptions
from corporeal.fitting.subject_template import SubjectTemplate, personal_model
from corporeal.fitting.track import Tracker
from corporeal.geometry.normals import vertex_normals
from corporeal.model.files import open_model
from corporeal.model.jacobian import evaluate
from corporeal.scans.scan import Scan, Unit
from corporeal.terms.hinges import HINGE_SIGMA, hinge_terms
from corporeal.terms.model_fields import ModelFields
from corporeal.terms.scan_to_surface import MovingSurface

OPTIONS = TrackingOptions(samples=6000, body_points=3000)


@pytest.fixture(scope="module")
def person():
    body = open_model("body")
    return personal_model(body, body.template)


def _posed(person, bend, turn=0.0):
    """Arms that hang, the left one turned about itself and its elbow bent, degrees."""
    pose = np.zeros((person.joint_count, 3))
    pose[person.joint_names.index("left_shoulder"), 2] = -1.2
    pose[person.joint_names.index("right_shoulder"), 2] = 1.2
    fields = ModelFields(person, shape_count=0)
    search = _search(person)
    pose[[search.shoulder, search.elbow]] = search._turned(pose, np.deg2rad(turn), np.deg2rad(bend))
    return pose, evaluate(person, np.zeros(0), pose, np.zeros(3)).vertices, fields


def _search(person):
    columns = ModelFields(person, shape_count=0).columns
    hinges = hinge_terms(person, columns, HINGE_SIGMA)[0]
    return ArmSearch.below(person, person.joint_names.index("left_elbow"), hinges)


def _arm(person, *names):
    """What the left elbow, or the joints named, carry with the hand."""
    below = [person.joint_names.index(f"left_{name}") for name in names or ("elbow", "wrist")]
    below += person.block("left_hand").joints
    return person.skinning_weights[:, below].sum(axis=1) > 0.5


def _scan(person, vertices, missing=None):
    faces = person.faces if missing is None else person.faces[~missing[person.faces].any(axis=1)]
    used, faces = np.unique(faces, return_inverse=True)
    faces = faces.reshape(-1, 3).astype(np.int64)
    return Scan("a", vertices[used], faces, vertex_normals(vertices[used], faces), None, Unit("m", 1.0))


def test_only_elbows_that_are_hinges_can_be_sought(person):
    hinges = hinge_terms(person, ModelFields(person, shape_count=0).columns, HINGE_SIGMA)[0]
    assert ArmSearch.below(person, person.joint_names.index("head"), hinges) is None


def test_the_search_lays_the_forearm_to_points_and_moves_nothing_else(person):
    pose, _, fields = _posed(person, 10)
    _, wanted, _ = _posed(person, 95, turn=-40)
    arm, surface = _arm(person), MovingSurface(person.template, person.faces)
    vector = np.concatenate([np.zeros(3), pose.ravel()])
    found, *others = _search(person).nearest(fields, surface, vector, wanted[arm][::7])
    assert len(others) <= 2
    vertices = fields.evaluated(found).vertices
    assert np.linalg.norm(vertices - wanted, axis=1)[arm].mean() < 0.03
    turned = {person.joint_names.index(f"left_{name}") for name in ("shoulder", "elbow")}
    changed = np.flatnonzero(np.abs((found - vector)[3:].reshape(-1, 3)).max(axis=1) > 0)
    assert set(changed.tolist()) <= turned


@pytest.mark.slow
def test_a_missing_forearm_is_held_and_found_again_elsewhere(person):
    start, before, _ = _posed(person, 20)
    _, after, _ = _posed(person, 100, turn=-60)
    template = SubjectTemplate(person, np.zeros(0), (), {}, start, np.zeros(3))
    tracker, elbow = Tracker(template, OPTIONS), person.joint_names.index("left_elbow")
    seen = tracker.step(_scan(person, before), "0")
    for number in (1, 2, 3):
        gone = tracker.step(_scan(person, before, _arm(person)), str(number))
        assert gone.signals["left_hand_seen"] < 0.15
        assert tracker.state.settling.tolist() == [10, 0]
    assert np.rad2deg(np.linalg.norm(gone.pose[elbow] - seen.pose[elbow])) < 2
    for number in (4, 5, 6):
        back = tracker.step(_scan(person, after), str(number))
    assert tracker.state.settling.tolist() == [7, 0]
    vertices = evaluate(person, np.zeros(0), back.pose, back.translation).vertices
    assert np.linalg.norm(vertices - after, axis=1)[_arm(person)].mean() < 0.005
    fingers = list(person.block("left_hand").joints)
    assert np.rad2deg(np.linalg.norm(back.pose[fingers] - gone.pose[fingers], axis=1)).max() < 20


@pytest.mark.slow
def test_a_forearm_that_is_seen_moves_without_its_hand(person):
    """Held like the hand, it would stay behind and the upper arm would turn for it."""
    start, before, _ = _posed(person, 20)
    template = SubjectTemplate(person, np.zeros(0), (), {}, start, np.zeros(3))
    tracker, hand = Tracker(template, OPTIONS), _arm(person, "wrist")
    tracker.step(_scan(person, before), "0")
    for number, bend in enumerate((25, 31, 38, 45)):
        _, true, _ = _posed(person, bend)
        found = tracker.step(_scan(person, true, hand), str(number))
    assert found.signals["left_hand_seen"] < 0.15 and found.signals["left_forearm_seen"] > 0.9
    vertices = evaluate(person, np.zeros(0), found.pose, found.translation).vertices
    forearm = _arm(person) & ~hand
    assert np.linalg.norm(vertices - true, axis=1)[forearm].mean() < 0.002
