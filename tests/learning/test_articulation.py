"""Joints, poses and templates solved for together, against derivatives by differences and a known model."""

import dataclasses

import numpy as np
import pytest
import scipy.sparse as sp

from corporeal.geometry.rotations_numeric import matrix_from_axis_angle
from corporeal.learning import articulation
from corporeal.learning.articulation import fit_articulation
from corporeal.learning.hinges import HingePrior
from corporeal.learning.objective import Priors
from corporeal.learning.state import LearningState, Registrations

STEP = 1e-6
HELD = 1e-6
"""Observations that hold the joints: next to none."""


def problem(tube, *, shift=0.0, hinges=None):
    """The tube's bones with true joints moved by ``shift`` metres: state, registrations, priors."""
    training, rng = tube.training, np.random.default_rng(5)
    rigid = np.flatnonzero(tube.model.skinning_weights.max(axis=1) > 0.97)
    hands = sorted(set(training.hands))
    templates = np.stack(
        [
            tube.model.template + tube.model.shape_directions @ tube.coefficients[hand.split("/")[0]]
            for hand in hands
        ]
    )
    true = np.stack([tube.model.joint_regressor @ template for template in templates])
    K = tube.model.joint_count
    state = LearningState(
        templates=templates[:, rigid],
        joints=true + shift * rng.standard_normal(true.shape),
        weights=np.eye(K)[tube.model.skinning_weights[rigid].argmax(axis=1)],
        pose_directions=np.zeros((9 * (K - 1), 3 * len(rigid))),
        regressor=sp.csr_matrix((K, len(rigid))),
        rotations=matrix_from_axis_angle(training.poses.reshape(-1, 3)).reshape(-1, K, 3, 3),
        translations=training.translations,
        parents=np.asarray(tube.model.parents),
    )
    data = Registrations(
        training.vertices[:, rigid],
        np.array([hands.index(hand) for hand in training.hands]),
        np.ones(len(training)),
    )
    strengths = np.tile(HELD * np.eye(3), (len(hands), K, 1, 1))
    distances = np.zeros((K - 1, len(rigid)))
    return state, data, Priors(state.templates, state.weights, strengths, distances, hinges), true


def first_hand(state, data, priors, held):
    """Private pieces of the first hand."""
    rows = np.flatnonzero(data.hands == 0)
    rig = articulation._rig(state)
    fixed = articulation._Held(
        data.vertices[rows],
        priors.templates[0],
        articulation._patch_turns(priors.templates[0], state.weights),
        held[0],
        priors.joint_strengths[0],
        priors.hinges,
    )
    hand = articulation._Hand(
        state.templates[0], state.joints[0], state.rotations[rows], state.translations[rows]
    )
    return hand, rig, fixed


def test_vertices_move_as_their_derivatives_say(make_tube, rng):
    state, data, priors, true = problem(make_tube(people=3, count=3), shift=1e-3)
    hand, rig, held = first_hand(state, data, priors, true)
    linear = articulation._linear(hand, rig, held)
    for _ in range(5):
        template, joints = rng.standard_normal(hand.template.shape), rng.standard_normal(hand.joints.shape)
        poses = rng.standard_normal((len(hand.rotations), linear.turns.shape[-1]))
        turns = matrix_from_axis_angle(STEP * poses[:, 3:].reshape(-1, 3)).reshape(hand.rotations.shape)
        moved = articulation._Hand(
            hand.template + STEP * template, hand.joints + STEP * joints, turns @ hand.rotations,
            hand.translations + STEP * poses[:, :3],
        )  # fmt: skip
        differences = (linear.residuals - articulation._linear(moved, rig, held).residuals) / STEP
        expected = (
            np.einsum("nvab,vb->nva", linear.blended, template)
            + linear.moves @ joints.ravel()
            + np.einsum("nvaq,nq->nva", linear.turns, poses)
        )
        np.testing.assert_allclose(differences, expected, atol=1e-5 * np.abs(expected).max())


@pytest.mark.parametrize("hinged", [False, True])
def test_the_gradient_is_that_of_the_cost(make_tube, rng, hinged):
    hinges = (
        HingePrior(np.full((3, 3), 0.1), np.tile(np.diag([3e-3, 1e-3, 0.0]), (3, 1, 1))) if hinged else None
    )
    state, data, priors, true = problem(make_tube(people=3, count=3), shift=1e-3, hinges=hinges)
    state = dataclasses.replace(
        state, templates=state.templates + 1e-3 * rng.standard_normal(state.templates.shape)
    )
    hand, rig, held = first_hand(state, data, priors, true + 1e-3)
    linear = articulation._linear(hand, rig, held)
    _, gradient = articulation._shared_equations(hand, rig, held, linear)
    flat = linear.turns.reshape(len(hand.rotations), -1, linear.turns.shape[-1])
    pulls = np.einsum("nrq,nr->nq", flat, linear.residuals.reshape(len(flat), -1))
    if hinges is not None:
        pulls[:, 3:] += hinges.equations(hand.rotations)[1].reshape(len(pulls), -1)
    for _ in range(5):
        shared, poses = rng.standard_normal(len(gradient)), rng.standard_normal(pulls.shape)
        costs = []
        for step in (STEP, -STEP):
            turns = matrix_from_axis_angle(step * poses[:, 3:].reshape(-1, 3)).reshape(hand.rotations.shape)
            size = hand.template.size
            moved = articulation._Hand(
                hand.template + step * shared[:size].reshape(-1, 3),
                hand.joints + step * shared[size:].reshape(-1, 3),
                turns @ hand.rotations,
                hand.translations + step * poses[:, :3],
            )
            costs.append(articulation._cost(moved, rig, held))
        slope = (costs[0] - costs[1]) / (2 * STEP)
        assert slope == pytest.approx(-2 * (gradient @ shared + (pulls * poses).sum()), rel=1e-5)


def test_joints_are_found_where_the_bones_turn(known_tube):
    state, data, priors, true = problem(known_tube, shift=2e-3)
    before = np.linalg.norm(state.joints - true, axis=2)[:, 1:]
    found = fit_articulation(state, data, priors, state.joints)
    after = np.linalg.norm(found.joints - true, axis=2)[:, 1:]
    assert before.mean() > 2e-3
    # What is left is the correctives of the known tube, which these bones do not have.
    assert after.mean() < 0.15 * before.mean()
    assert found.squared_errors(data).sum() < 0.2 * state.squared_errors(data).sum()


def test_bones_keep_their_direction_in_the_template(known_tube):
    state, data, priors, true = problem(known_tube)
    turned = matrix_from_axis_angle(np.tile([0.0, 0.0, 0.2], (len(state.rotations), 1)))
    rotations = state.rotations.copy()
    rotations[:, 2] = rotations[:, 2] @ turned
    start = dataclasses.replace(state, rotations=rotations)
    found = fit_articulation(start, data, priors, true)
    turns = articulation._patch_turns(priors.templates[0], state.weights)
    drift = turns @ (found.templates[0] - priors.templates[0]).ravel()
    assert np.rad2deg(np.abs(drift).max()) < 0.5
    off = found.rotations[:, 2].swapaxes(1, 2) @ state.rotations[:, 2]
    assert np.rad2deg(np.arccos(np.clip((np.trace(off, axis1=1, axis2=2) - 1) / 2, -1, 1))).mean() < 5
