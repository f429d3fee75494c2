"""Shares of variance against sums done by hand, and what is refused."""

import numpy as np
import pytest

from corporeal.learning.evaluation.compactness import compactness
from corporeal.learning.shape_space import principal_components


def test_shares_are_what_a_reconstruction_of_the_data_explains(rng):
    rows = rng.normal(size=(30, 6)) * [5, 3, 2, 1, 0.5, 0.1]
    space = principal_components(rows)
    curve = compactness("m", "pose", space.variances)
    centred = rows - rows.mean(axis=0)
    for count, share in zip(curve.components, curve.shares, strict=True):
        directions = space.directions[:count]
        left = centred - centred @ directions.T @ directions
        assert share == pytest.approx(1 - (left**2).sum() / (centred**2).sum(), abs=1e-12)
    assert curve.shares[-1] == 1.0


def test_the_figures_of_the_paper_stand_beside_the_pose_space_only():
    pose = compactness("m", "pose", np.ones(3))
    assert dict(zip(pose.paper.components, pose.paper.shares, strict=True)) == {6: 0.81, 10: 0.90, 15: 0.95}
    assert compactness("m", "shape", np.ones(3)).paper is None


@pytest.mark.parametrize("variances", [[], [0.0, 0.0], [1.0, -0.1], [1.0, 2.0]])
def test_numbers_that_are_no_descending_variances_are_refused(variances):
    with pytest.raises(ValueError, match="variances"):
        compactness("m", "shape", np.array(variances, dtype=float))
