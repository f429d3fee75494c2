"""A given pose prior: it stands in for the model's own, for either hand, and helps where nothing is seen."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from corporeal.model.jacobian import ParameterColumns
from corporeal.model.mirror import mirror_model
from corporeal.registration.gaussian_pose import GaussianPose, pose_priors
from corporeal.registration.options import RegistrationOptions
from corporeal.registration.priors import prior_terms
from corporeal.registration.register import register
from corporeal.registration.stages import Fitter, MeasuredLandmarks
from corporeal.registration.starts import landmark_start
from corporeal.registration.target import Target


def _terms(model, prior):
    columns = ParameterColumns.of_counts(model.joint_count, 10, 0)
    found = prior_terms(
        model, columns, shape_sigma=1.0, pose_prior_scale=2.0, limit_sigma=0.05, pose_prior=prior
    )
    return {term.name: term for term in found}


def test_the_given_prior_takes_the_place_of_the_models_own(hand, rng):
    factor = 0.1 * rng.standard_normal((45, 45))
    prior = GaussianPose(rng.standard_normal(45), factor @ factor.T, "right")
    neutral, given = _terms(hand, None), _terms(hand, prior)
    assert neutral.keys() == given.keys()
    term = given["hand prior"]
    np.testing.assert_array_equal(term.mean, prior.mean)
    expected = np.linalg.inv(prior.covariance + np.deg2rad(3.0) ** 2 * np.eye(45)) / 4
    np.testing.assert_allclose(term.precision, expected, rtol=1e-9)
    mirrored = _terms(mirror_model(hand), prior)["hand prior"]
    np.testing.assert_array_equal(mirrored.mean.reshape(-1, 3), prior.mean.reshape(-1, 3) * [1, -1, -1])


def test_a_prior_of_too_few_joints_is_refused(hand):
    with pytest.raises(ValueError, match="too few for pose block 'hand'"):
        _terms(hand, GaussianPose(np.zeros(9), np.eye(9)))


def test_a_finger_without_landmarks_is_put_where_the_prior_says(hand, make_capture):
    capture = make_capture(hand, 3)
    truth = register(capture.scan, hand, capture.evidence, "right").parameters.pose
    known = hand.landmarks["hand_21_mediapipe"]
    names = [name for name in known.names if not name.startswith("index")]
    positions = np.array([capture.evidence.positions[name] for name in names])
    marks = MeasuredLandmarks(known.reordered(names), positions, np.ones(len(names)))
    index = [number for number, name in enumerate(hand.joint_names) if "index" in name]
    prior = GaussianPose(truth[1:].ravel(), np.deg2rad(5.0) ** 2 * np.eye(45), "right")
    degrees = []
    for options in (RegistrationOptions(), RegistrationOptions(pose_prior=prior)):
        fitter = Fitter(hand, Target(capture.scan), marks, options)
        pose = np.zeros_like(truth) if options.pose_prior is None else options.pose_prior.pose
        start, _ = landmark_start(
            hand, marks.landmark_set, positions, np.ones(len(names)), pose, fitter.fields.shape_count
        )
        fitted = fitter.fields.parameters(fitter.fit_landmarks(start, options.landmarks).state.parameters)
        turns = Rotation.from_rotvec(fitted.pose[index]) * Rotation.from_rotvec(truth[index]).inv()
        degrees.append(np.rad2deg(turns.magnitude()).mean())
    assert degrees[1] < 2.0 and degrees[0] > 5.0, degrees


def test_few_poses_lean_on_the_general_covariance_and_many_do_not(rng):
    def poses(count, spread):
        found = np.zeros((count, 16, 3))
        found[:, 1:] = spread * rng.standard_normal((count, 15, 3))
        return list(found)

    priors = pose_priors({"few": poses(3, 0.01), "many": poses(2000, 0.01), "wild": poses(500, 0.5)}, "right")
    general = np.trace(priors["wild"].covariance) / 45
    assert np.sqrt(np.trace(priors["many"].covariance) / 45) < 0.03
    assert 0.05 * general < np.trace(priors["few"].covariance) / 45 < general
    assert "two" not in pose_priors({"two": poses(2, 0.1)}, "right")
