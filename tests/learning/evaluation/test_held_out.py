"""What is scored of a held-out session, and what personal templates are made of."""

import dataclasses

import numpy as np
import pytest

from corporeal.learning.evaluation.held_out import held_out, personal_models
from corporeal.learning.training_set import LearningError


@pytest.fixture
def session(known_tube):
    """Eight people with eleven registrations each: person i has i natural ones, at the end."""
    poses = [
        "natural" if number % 11 >= 11 - number // 11 else "asked"
        for number in range(len(known_tube.training))
    ]
    return dataclasses.replace(known_tube.training, protocol_poses=tuple(poses))


def test_scored_scans_are_spread_over_subjects_and_never_make_a_template(session):
    chosen = held_out(session, "natural", most=16)
    assert len(chosen.scored) == 16
    assert {session.protocol_poses[index] for index in chosen.scored} == {"natural"}
    people = [session.subjects[index] for index in chosen.scored]
    # Persons 1 and 2 have one and two; the third turn ends with person 5.
    assert [people.count(f"s{person:02d}") for person in range(8)] == [0, 1, 2, 3, 3, 3, 2, 2]
    assert not set(chosen.scored) & set(chosen.kept)
    assert len(chosen.kept) + len(chosen.scored) == len(session)
    assert chosen.hands == tuple(f"s{person:02d}/right" for person in range(1, 8))


def test_the_choice_follows_names_and_not_the_order(session, rng):
    order = rng.permutation(len(session))
    here, there = held_out(session, "natural", 10), held_out(session.subset(order), "natural", 10)
    names = [{one.registrations.names[index] for index in one.scored} for one in (here, there)]
    assert names[0] == names[1]


def test_too_few_scans_and_hands_without_others_are_noted(session):
    poses = [
        "natural" if person == "s03" else pose
        for person, pose in zip(session.subjects, session.protocol_poses, strict=True)
    ]
    chosen = held_out(dataclasses.replace(session, protocol_poses=tuple(poses)), "natural", most=50)
    assert "s03/right" not in chosen.hands
    assert len(chosen.scored) == 28 - 3
    assert any("50 scans were asked for" in note for note in chosen.notes)
    assert any("not scored" in note and "s03/right" in note for note in chosen.notes)


def test_nothing_to_score_is_refused(session):
    with pytest.raises(LearningError, match="'unknown'"):
        held_out(session, "unknown")


def test_personal_templates_are_those_of_the_others(known_tube, session):
    """A wrecked scored registration changes nothing, a wrecked other one does."""
    chosen = held_out(session, "natural", most=4)
    models = []
    for wrecked in (chosen.scored[:0], chosen.scored, chosen.kept):
        vertices = session.vertices.copy()
        vertices[wrecked] += 0.01 * np.sin(np.arange(known_tube.model.vertex_count))[:, None]
        registrations = dataclasses.replace(session, vertices=vertices)
        models.append(
            personal_models(known_tube.model, dataclasses.replace(chosen, registrations=registrations))
        )
    assert set(models[0]) == set(chosen.hands)
    for hand in chosen.hands:
        np.testing.assert_array_equal(models[0][hand].template, models[1][hand].template)
        assert np.abs(models[0][hand].template - models[2][hand].template).max() > 1e-3
        assert models[0][hand].shape_count == 0
