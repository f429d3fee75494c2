"""What learning reads: only accepted registrations, all of one side."""

import dataclasses

import numpy as np
import pytest

from corporeal.learning.training_set import LearningError, TrainingSet, training_set
from corporeal.model.jacobian import evaluate
from corporeal.model.mirror import mirror_model
from corporeal.registration.session.records import SessionRecord


def record(name, side, model, pose, *, status="ok", **row):
    translation = np.array([0.1, 0.2, 0.3])
    return SessionRecord(
        row={"name": name, "status": status, **row},
        vertices=evaluate(model, np.zeros(1), pose, translation).vertices,
        pose=pose,
        shape=np.full(1, 0.5),
        translation=translation,
        side=side,
    )


@pytest.fixture
def model(make_tube):
    return make_tube(people=4, count=1).start


@pytest.fixture
def pose(model, rng):
    return 0.4 * rng.standard_normal((model.joint_count, 3))


def test_left_registrations_are_mirrored_in(model, pose):
    """What comes in of a left hand is posed by the right model to the same surface."""
    records = [
        record("a", "left", mirror_model(model), pose, subject="s1", protocol_pose="fist"),
        record("b", "right", model, pose, subject="s1"),
    ]
    found = training_set(records, model)
    for index in range(2):
        posed = evaluate(model, np.zeros(1), found.poses[index], found.translations[index])
        assert np.abs(posed.vertices - found.vertices[index]).max() < 1e-12
    assert found.hands == ("s1/left", "s1/right")
    assert found.subjects == ("s1", "s1")
    assert found.protocol_poses == ("fist", "")
    assert np.array_equal(found.poses[1], pose)


def test_a_left_model_takes_right_ones_mirrored(model, pose):
    found = training_set([record("b", "right", model, pose)], mirror_model(model))
    posed = evaluate(mirror_model(model), np.zeros(1), found.poses[0], found.translations[0])
    assert np.abs(posed.vertices - found.vertices[0]).max() < 1e-12


def test_the_curator_decides_over_the_status(model, pose):
    records = [
        record("kept", "right", model, pose),
        record("rejected", "right", model, pose),
        record("doubted", "right", model, pose, status="doubtful"),
        record("failed but accepted", "right", model, pose, status="failed"),
        SessionRecord({"name": "nothing there", "status": "failed"}),
        SessionRecord({"name": "nothing to accept", "status": "failed"}),
    ]
    decisions = {"rejected": "reject", "failed but accepted": "accept", "nothing to accept": "accept"}
    assert training_set(records, model, decisions).names == ("kept", "failed but accepted")


def test_refusals_name_the_registration(model, pose):
    good = record("good", "right", model, pose)
    with pytest.raises(LearningError, match="none of 1 registrations is accepted"):
        training_set([good], model, {"good": "reject"})
    broken = good.vertices.copy()
    broken[3, 1] = np.nan
    with pytest.raises(LearningError, match=r"good: .*not finite"):
        training_set([dataclasses.replace(good, vertices=broken)], model)
    with pytest.raises(LearningError, match="good: a registration of 251 vertices"):
        training_set([dataclasses.replace(good, vertices=good.vertices[1:])], model)


def test_subset_and_joined_keep_rows_together(known_tube):
    training = known_tube.training
    marks = np.array([subject != "s02" for subject in training.subjects])
    both = training.subset(marks).joined(training.subset(np.flatnonzero(~marks)))
    order = [both.names.index(name) for name in training.names]
    again = both.subset(np.array(order))
    for field in dataclasses.fields(TrainingSet):
        assert np.array_equal(getattr(again, field.name), getattr(training, field.name)), field.name


def test_rows_of_different_number_are_refused(known_tube):
    with pytest.raises(ValueError, match="subjects: 1 entries, 88 registrations"):
        dataclasses.replace(known_tube.training, subjects=("s00",))
