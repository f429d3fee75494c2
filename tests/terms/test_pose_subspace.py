"""Poses of few components: what is free, what is held, and that fits stay inside."""

import numpy as np
import pytest

from corporeal.model.files import open_model
from corporeal.solve.problem import Problem, State
from corporeal.solve.subspace import RestrictedProblem
from corporeal.terms.gaussian_prior import GaussianPrior
from corporeal.terms.landmarks import LandmarkDistances
from corporeal.terms.model_fields import LANDMARKS, ModelFields
from corporeal.terms.pose_subspace import pose_subspace


@pytest.fixture(scope="module")
def hand():
    return open_model("hand")


@pytest.mark.parametrize("count", [0, 1, 6, 45])
def test_lifted_poses_are_mean_and_components_and_all_else_is_free(hand, rng, count):
    columns = ModelFields(hand, shape_count=4).columns
    subspace = pose_subspace(hand, columns, count)
    assert subspace.directions.shape == (columns.count, 3 + 3 + 4 + count)
    vector = rng.normal(size=columns.count)
    lifted = subspace.lifted(subspace.nearest(vector))
    free = np.r_[0:6, 51:55]
    assert np.abs(lifted - vector)[free].max() < 1e-12
    block = hand.block("hand")
    fingers, components = lifted[6:51] - block.mean, block.components[:count]
    inside = np.linalg.lstsq(components.T, fingers, rcond=None)[0] @ components if count else 0 * fingers
    assert np.abs(fingers - inside).max() < 1e-9


def test_more_components_hold_the_poses_of_fewer(hand, rng):
    columns = ModelFields(hand, shape_count=0).columns
    few, more = (pose_subspace(hand, columns, count) for count in (3, 10))
    vector = few.lifted(rng.normal(size=few.directions.shape[1]))
    assert np.abs(more.lifted(more.nearest(vector)) - vector).max() < 1e-9


def test_the_chain_rule_goes_through_the_components(hand, rng):
    landmarks = hand.landmarks["hand_21_mediapipe"]
    fields = ModelFields(hand, shape_count=3, landmarks=landmarks)
    positions = rng.normal(scale=0.1, size=(len(landmarks.names), 3))
    terms = [
        LandmarkDistances("landmarks", LANDMARKS, positions, np.full(len(positions), 5e-3), np.inf),
        GaussianPrior.isotropic("pose", fields.columns.pose, np.zeros(48), 0.7),
    ]
    problem = Problem(terms, fields.derive, fields.differentiate)
    restricted = RestrictedProblem(problem, pose_subspace(hand, fields.columns, 5))
    z = 0.3 * rng.normal(size=3 + 3 + 5 + 3)
    system = restricted.normal_system(restricted.evaluate(State(z)))
    for _ in range(4):
        along = rng.normal(size=z.size)
        up, down = (restricted.evaluate(State(z + sign * 1e-6 * along)).cost for sign in (1, -1))
        assert (up - down) / 2e-6 == pytest.approx(system.gradient @ along, rel=1e-6)


def test_what_the_model_does_not_have_is_refused(hand):
    columns = ModelFields(hand, shape_count=0).columns
    for count in (-1, 46):
        with pytest.raises(ValueError, match="expected 0 to 45"):
            pose_subspace(hand, columns, count)
    with pytest.raises(ValueError, match="expected 0 to 0"):
        pose_subspace(hand.replace(pose_blocks=()), columns, 0)
