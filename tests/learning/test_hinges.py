"""Which joints are hinges, and what their prior costs."""

import numpy as np

from corporeal.geometry.rotations_numeric import matrix_from_axis_angle
from corporeal.learning.hinges import HingePrior, hinge_prior
from corporeal.model.files import open_model

STEP = 1e-6


def test_recorded_poses_tell_the_hinges_of_a_hand():
    model = open_model("start_hand")
    prior = hinge_prior(model, 250.0)
    hinges = {name for name, own in zip(model.joint_names, prior.precisions, strict=True) if own.any()}
    fingers = ("index", "middle", "little", "ring")
    assert hinges == {f"{finger}{number}" for finger in fingers for number in (2, 3)} | {
        "thumb2",
        "thumb3",
    }
    ranks = np.linalg.matrix_rank(prior.precisions, hermitian=True)
    assert set(ranks) == {0, 2}


def test_the_farther_recorded_poses_spread_across_an_axis_the_weaker_it_is_held():
    model = open_model("start_hand")
    prior = hinge_prior(model, 250.0)
    held = {
        name: np.linalg.eigvalsh(prior.precisions[model.joint_names.index(name)])[1:] / 250e-4
        for name in ("index2", "thumb2")
    }
    np.testing.assert_allclose(held["index2"], 1.0)
    # 0.9 and 3.9 degrees, where 1.5 are held in full.
    np.testing.assert_allclose(held["thumb2"], [(1.5 / 3.9) ** 2, 1.0], rtol=0.05)


def test_a_model_without_recorded_poses_has_none(known_tube):
    assert hinge_prior(known_tube.start, 250.0) is None


def test_no_strength_is_no_prior():
    assert hinge_prior(open_model("start_hand"), 0.0) is None


def test_turns_about_the_axis_are_free_and_others_cost():
    axis = np.array([0.0, 0.6, 0.8])
    prior = HingePrior(np.zeros((1, 3)), 4.0 * (np.eye(3) - np.outer(axis, axis))[None])
    about = matrix_from_axis_angle(np.linspace(-1.5, 1.5, 7)[:, None] * axis)[:, None]
    assert np.abs(prior.costs(about)).max() < 1e-14
    across = matrix_from_axis_angle(np.array([[0.1, 0.0, 0.0], [0.2, 0.0, 0.0]]))[:, None]
    np.testing.assert_allclose(prior.costs(across), 4 * np.array([0.1, 0.2]) ** 2)


def test_pulls_are_the_slope_of_the_cost(rng):
    halves = rng.standard_normal((4, 3, 3))
    prior = HingePrior(0.1 * rng.standard_normal((4, 3)), halves @ halves.swapaxes(1, 2))
    turned = rng.uniform(-1.2, 1.2, (5, 4, 3))
    rotations = matrix_from_axis_angle(turned.reshape(-1, 3)).reshape(5, 4, 3, 3)
    blocks, pulls = prior.equations(rotations)
    assert (np.linalg.eigvalsh(blocks) > 0).all()
    for _ in range(5):
        direction = rng.standard_normal((5, 4, 3))
        costs = [
            prior.costs(
                matrix_from_axis_angle((step * direction).reshape(-1, 3)).reshape(5, 4, 3, 3) @ rotations
            )
            for step in (STEP, -STEP)
        ]
        slopes = (costs[0] - costs[1]) / (2 * STEP)
        np.testing.assert_allclose(slopes, -2 * np.einsum("nka,nka->n", pulls, direction), rtol=1e-5)
