"""Shape spaces: unit variance, and the sum with a prior space."""

import numpy as np
import pytest

from corporeal.learning.shape_space import principal_components, shape_directions


def test_coefficients_of_the_training_rows_have_unit_variance(rng):
    rows = rng.normal(size=(9, 12)) * np.arange(1, 13)
    components = principal_components(rows)
    directions = shape_directions(components, 30)
    assert directions.shape == (4, 3, 8)
    coefficients = (rows - components.mean) @ np.linalg.pinv(directions.reshape(12, 8)).T
    assert np.abs(np.cov(coefficients.T) - np.eye(8)).max() < 1e-9


@pytest.mark.parametrize("weight", [0.0, 0.3, 2.0])
def test_covariances_are_added_across_the_first_component(rng, weight):
    rows, prior = rng.normal(size=(6, 12)), rng.normal(size=(4, 3, 3))
    components = principal_components(rows)
    summed = shape_directions(components, 30, prior, weight).reshape(12, -1)
    other = prior.reshape(12, 3)
    size = components.directions[0]
    other -= np.outer(size, size @ other)
    expected = np.cov(rows.T) + weight * other @ other.T
    assert np.abs(summed @ summed.T - expected).max() < 1e-12
    assert (np.diff(np.linalg.norm(summed, axis=0)) <= 1e-12).all()


def test_a_negative_weight_is_refused(rng):
    components = principal_components(rng.normal(size=(6, 12)))
    with pytest.raises(ValueError, match=r"prior_weight: expected 0 or more, got -1\.5"):
        shape_directions(components, 5, np.ones((4, 3, 1)), -1.5)
