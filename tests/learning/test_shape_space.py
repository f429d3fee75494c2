"""Shape spaces: unit variance, and the mixture with a prior space."""

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


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_covariances_are_mixed_by_their_share(rng, share):
    rows, prior = rng.normal(size=(6, 12)), rng.normal(size=(4, 3, 3))
    components = principal_components(rows)
    mixed = shape_directions(components, 30, prior, share).reshape(12, -1)
    other = prior.reshape(12, 3)
    expected = (1 - share) * np.cov(rows.T) + share * other @ other.T
    assert np.abs(mixed @ mixed.T - expected).max() < 1e-12
    assert (np.diff(np.linalg.norm(mixed, axis=0)) <= 1e-12).all()


def test_a_share_outside_its_range_is_refused(rng):
    components = principal_components(rng.normal(size=(6, 12)))
    with pytest.raises(ValueError, match=r"prior_share: expected 0 to 1, got 1\.5"):
        shape_directions(components, 5, np.ones((4, 3, 1)), 1.5)
