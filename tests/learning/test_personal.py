"""One person's template in a model that is known."""

import numpy as np
import pytest

from corporeal.learning.personal import fitted_poses, personal_model, personal_template
from corporeal.model.jacobian import evaluate


@pytest.fixture(scope="module")
def person(make_tube):
    """Six registrations of one person, 2 mm off the mean shape."""
    tube = make_tube(people=4, count=6)
    return tube, tube.training.subset(np.arange(6))


def test_unseen_person_is_met_to_the_noise(person, noise_rms_mm):
    tube, training = person
    found = personal_template(tube.model, training.vertices, training.poses, training.translations)
    model = personal_model(tube.model, found.template)
    assert model.shape_count == 0
    misses = [
        evaluate(model, np.zeros(0), pose, place).vertices - scan
        for pose, place, scan in zip(found.poses, found.translations, training.vertices, strict=True)
    ]
    assert 1e3 * np.sqrt(np.square(misses).sum(axis=2).mean()) < noise_rms_mm
    mean_shape = personal_model(tube.model, tube.model.template)
    truth = tube.model.template + tube.model.shape_directions @ tube.coefficients["s00"]
    assert 1e3 * np.linalg.norm(truth - mean_shape.template, axis=1).mean() > 1.5, "the test wants a shape"


def test_poses_alone_are_found_around_a_true_template(person, noise_rms_mm):
    tube, training = person
    truth = tube.model.template + tube.model.shape_directions @ tube.coefficients["s00"]
    fixed = personal_model(tube.model, truth)
    found = personal_template(fixed, training.vertices, training.poses, training.translations, passes=0)
    misses = [
        evaluate(fixed, np.zeros(0), pose, place).vertices - scan
        for pose, place, scan in zip(found.poses, found.translations, training.vertices, strict=True)
    ]
    assert 1e3 * np.sqrt(np.square(misses).sum(axis=2).mean()) < 1.1 * noise_rms_mm


def test_refusals(person):
    tube, training = person
    with pytest.raises(ValueError, match="expected some registrations of 252 vertices and 3 joints"):
        personal_template(tube.model, training.vertices[:0], training.poses[:0], training.translations[:0])
    with pytest.raises(ValueError, match=r"template: shape \(251, 3\)"):
        personal_model(tube.model, tube.model.template[1:])


def test_poses_around_a_kept_template_are_found(known_tube, rng):
    """From poses half a radian off; the template stays."""
    model = known_tube.model
    template = model.template + model.shape_directions @ rng.standard_normal(model.shape_count)
    own = personal_model(model, template)
    poses = 0.4 * rng.standard_normal((3, model.joint_count, 3))
    shifts = 0.1 * rng.standard_normal((3, 3))
    vertices = np.stack(
        [evaluate(own, np.zeros(0), pose, shift).vertices for pose, shift in zip(poses, shifts, strict=True)]
    )
    start = poses + 0.2 * rng.standard_normal(poses.shape)
    found = fitted_poses(own, vertices, start, np.zeros((3, 3)), passes=20)
    np.testing.assert_array_equal(found.template, template)
    for number in range(3):
        posed = evaluate(own, np.zeros(0), found.poses[number], found.translations[number]).vertices
        assert 1e3 * np.linalg.norm(posed - vertices[number], axis=1).max() < 0.1
