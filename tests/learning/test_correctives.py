"""The correctives' preconditioner is made anew for other poses, and only for them."""

import dataclasses

import numpy as np
import pytest

from corporeal.geometry.rotations_numeric import matrix_from_axis_angle
from corporeal.learning.correctives import Preconditioner, fit_correctives
from corporeal.learning.objective import Priors, corrective_costs
from corporeal.learning.options import LearningOptions
from corporeal.learning.state import LearningState, Registrations

OPTIONS = LearningOptions()


@pytest.fixture(scope="module")
def problem(known_tube):
    """The known model without its correctives: state, registrations, priors."""
    training, model = known_tube.training, known_tube.model
    hands = sorted(set(training.hands))
    templates = np.stack(
        [
            model.template + model.shape_directions @ known_tube.coefficients[hand.split("/")[0]]
            for hand in hands
        ]
    )
    K, V = model.joint_count, model.vertex_count
    state = LearningState(
        templates=templates,
        joints=np.stack([model.joint_regressor @ template for template in templates]),
        weights=np.asarray(model.skinning_weights),
        pose_directions=np.zeros((9 * (K - 1), 3 * V)),
        regressor=model.joint_regressor,
        rotations=matrix_from_axis_angle(training.poses.reshape(-1, 3)).reshape(-1, K, 3, 3),
        translations=training.translations,
        parents=np.asarray(model.parents),
    )
    numbers = np.array([hands.index(hand) for hand in training.hands])
    data = Registrations(training.vertices, numbers, np.ones(len(training)))
    strengths = np.tile(np.eye(3), (len(hands), K, 1, 1))
    return state, data, Priors(templates, state.weights, strengths, np.full((K - 1, V), 0.01), None)


def other_poses(state):
    turned = state.rotations.copy()
    turned[:, 1] = turned[::-1, 1]
    return dataclasses.replace(state, rotations=turned)


def test_it_is_kept_while_poses_are_held_and_made_anew_for_others(problem):
    state, _, priors = problem
    costs = np.repeat(corrective_costs(priors, OPTIONS), 9, axis=0)
    shared = Preconditioner()
    first = shared.inverse(state, costs)
    assert shared.inverse(dataclasses.replace(state, templates=state.templates + 0.01), costs) is first
    assert not np.array_equal(shared.inverse(other_poses(state), costs), first)


@pytest.mark.parametrize("change", [lambda state: state, other_poses])
def test_correctives_are_the_same_with_a_shared_one(problem, change):
    state, data, priors = problem
    shared = Preconditioner()
    fit_correctives(state, data, priors, OPTIONS, shared)
    alone = fit_correctives(change(state), data, priors, OPTIONS)
    together = fit_correctives(change(state), data, priors, OPTIONS, shared)
    assert alone.has_correctives
    np.testing.assert_array_equal(together.pose_directions, alone.pose_directions)
