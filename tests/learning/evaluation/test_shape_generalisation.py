"""Left-out templates against a space that is known."""

import numpy as np
import pytest

from corporeal.learning.evaluation.shape_generalisation import shape_generalisation

PEOPLE = [f"s{number}" for number in range(6) for _ in range(2)]
HANDS = [f"{person}/{side}" for person, side in zip(PEOPLE, ["left", "right"] * 6, strict=True)]


def templates_of(rng, own=0.0, noise=0.0):
    """Three true directions; ``own`` is a direction that each subject has alone, in both hands."""
    mean, directions = rng.normal(size=(20, 3)), rng.normal(size=(3, 20, 3))
    scores = rng.normal(size=(12, 3)) * [0.01, 0.005, 0.003]
    own_directions = np.repeat(rng.normal(size=(6, 20, 3)), 2, axis=0)
    return (
        mean
        + np.einsum("hn,nvc->hvc", scores, directions)
        + own * own_directions
        + noise * rng.normal(size=(12, 20, 3))
    )


def test_a_subject_of_the_others_space_is_met_exactly_by_its_dimensions(rng):
    curve = shape_generalisation("m", templates_of(rng), HANDS, PEOPLE, [0, 1, 2, 3])
    assert curve.mean[-1] < 1e-9
    assert min(curve.mean[:-1]) > 0.1
    assert (curve.n_hands, curve.n_subjects) == (12, 6)


def test_both_hands_of_a_subject_are_left_out(rng):
    # Were the other hand among the learned, what this subject has alone would be explained by it.
    templates = templates_of(rng, own=0.01)
    curve = shape_generalisation("m", templates, HANDS, PEOPLE, [9])
    assert curve.mean[0] > 1.0
    alone = shape_generalisation("m", templates, HANDS, HANDS, [10])
    assert alone.mean[0] < 0.5 * curve.mean[0]


def test_errors_are_distances_from_the_projection_and_fall(rng):
    templates = templates_of(rng, noise=0.002)
    components = list(range(10))
    curve = shape_generalisation("m", templates, HANDS, PEOPLE, components)
    others = templates[2:].reshape(10, -1)
    basis = np.linalg.svd(others - others.mean(axis=0))[2][:4]
    offset = templates[0].ravel() - others.mean(axis=0)
    left = (offset - basis.T @ (basis @ offset)).reshape(-1, 3)
    assert curve.hands[0].by_components[4] == pytest.approx(1e3 * np.linalg.norm(left, axis=1).mean())
    assert np.all(np.diff(curve.mean) < 0)
    by_hand = np.array([hand.by_components for hand in curve.hands])
    assert np.allclose(curve.mean, by_hand.mean(axis=0))
    assert np.allclose(curve.sd, by_hand.std(axis=0, ddof=1))


def test_what_cannot_be_answered_is_refused(rng):
    templates = templates_of(rng)
    with pytest.raises(ValueError, match="allow 9"):
        shape_generalisation("m", templates, HANDS, PEOPLE, [10])
    with pytest.raises(ValueError, match="ascending"):
        shape_generalisation("m", templates, HANDS, PEOPLE, [2, 1])
    with pytest.raises(ValueError, match="three subjects"):
        shape_generalisation("m", templates[:4], HANDS[:4], PEOPLE[:4], [1])
