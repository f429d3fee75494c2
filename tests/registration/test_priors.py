"""The model's own priors: least at what is usual, and of every pose block."""

import numpy as np

from corporeal.model.jacobian import ParameterColumns
from corporeal.registration.priors import prior_terms
from corporeal.solve.problem import PARAMETERS


def costs(model, pose, shape, **changes):
    numbers = {"shape_sigma": 1.0, "pose_prior_scale": 1.0, "limit_sigma": 0.05} | changes
    columns = ParameterColumns.of_counts(model.joint_count, len(shape), 0)
    vector = np.concatenate([np.zeros(3), pose.ravel(), shape])
    return {term.name: term.at({PARAMETERS: vector}).cost for term in prior_terms(model, columns, **numbers)}


def test_every_pose_block_has_a_prior_and_its_limits(hand):
    names = set(costs(hand, np.zeros((hand.joint_count, 3)), np.zeros(10)))
    assert names == {"shape prior", "hand prior", "hand limits"}


def test_shape_and_pose_cost_as_their_deviations_say(hand, rng):
    shape, pose = rng.standard_normal(10), 0.3 * rng.standard_normal((hand.joint_count, 3))
    found = costs(hand, pose, shape)
    np.testing.assert_allclose(found["shape prior"], 0.5 * shape @ shape)
    np.testing.assert_allclose(costs(hand, pose, shape, shape_sigma=0.5)["shape prior"], 2 * shape @ shape)
    assert costs(hand, pose, shape, pose_prior_scale=2.0)["hand prior"] < found["hand prior"]


def test_a_mean_of_the_mixture_costs_less_than_what_is_beside_it(hand, rng):
    means = hand.block("hand").mixture.means
    for mean in means[:5]:
        pose = np.zeros((hand.joint_count, 3))
        pose[list(hand.block("hand").joints)] = mean.reshape(-1, 3)
        aside = pose + np.r_[np.zeros((1, 3)), 0.3 * rng.standard_normal((hand.joint_count - 1, 3))]
        assert costs(hand, pose, np.zeros(5))["hand prior"] < costs(hand, aside, np.zeros(5))["hand prior"]


def test_turning_the_whole_hand_costs_nothing(hand):
    still, moved = np.zeros((hand.joint_count, 3)), np.zeros((hand.joint_count, 3))
    moved[0] = [2.0, -1.0, 0.5]
    assert costs(hand, still, np.zeros(5)) == costs(hand, moved, np.zeros(5))


def test_limits_cost_only_beyond_them(hand):
    pose = np.zeros((hand.joint_count, 3))
    assert costs(hand, pose, np.zeros(5))["hand limits"] < 1e-9
    pose[2] = [0.0, 0.0, 2.5]
    bent = costs(hand, pose, np.zeros(5))["hand limits"]
    pose[2] = [0.0, 0.0, -2.5]
    assert max(bent, costs(hand, pose, np.zeros(5))["hand limits"]) > 10
