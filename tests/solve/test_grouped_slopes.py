"""Products with grouped slopes, against the same products with the whole Jacobian."""

import numpy as np
import pytest
import scipy.sparse as sp

from corporeal.solve.curvature import BlockCurvature, DenseCurvature, PerAxisCurvature
from corporeal.solve.grouped_slopes import GroupedSlopes, SlopeGroup

POINTS, PARAMETERS = 9, 7
# A chain of points: each is coupled to the ones beside it.
CHAIN = sp.diags([np.ones(POINTS - 1), np.full(POINTS, 3.0), np.ones(POINTS - 1)], (-1, 0, 1)).tocsr()


@pytest.fixture
def slopes(rng):
    """Points 0-4 depend on the first parameters, the others on the last, a group about the border on all."""
    whole = rng.normal(size=(POINTS, 3, PARAMETERS))
    whole[:5, :, 5:] = 0
    whole[5:, :, :2] = 0
    groups = []
    for own, beside, columns in (
        (np.arange(4), [4], np.arange(5)),
        (np.arange(4, 6), [3, 6], np.arange(PARAMETERS)),
        (np.arange(6, POINTS), [5], np.arange(2, PARAMETERS)),
    ):
        points = np.concatenate([own, beside])
        compact = np.ascontiguousarray(whole[points][:, :, columns])
        groups.append(SlopeGroup(len(own), points, columns, compact))
    return whole, GroupedSlopes(tuple(groups), whole.shape)


@pytest.fixture(params=["per axis", "blocks", "dense"])
def curvature(request, rng):
    if request.param == "per axis":
        return PerAxisCurvature(CHAIN)
    blocks = rng.normal(size=(CHAIN.nnz, 3, 3))
    pattern = sp.bsr_matrix((blocks, CHAIN.indices, CHAIN.indptr))
    whole = (pattern + pattern.T).tobsr((3, 3))
    whole.sort_indices()
    if request.param == "dense":
        return DenseCurvature(whole.toarray())
    return BlockCurvature(whole.indptr, whole.indices, whole.data)


def test_products_are_those_of_the_whole(slopes, curvature, rng):
    whole, grouped = slopes
    rows = whole.reshape(3 * POINTS, PARAMETERS)
    assert np.array_equal(grouped.dense(), rows)
    gradient = rng.normal(size=(POINTS, 3))
    np.testing.assert_allclose(grouped.pulled_gradient(gradient), rows.T @ gradient.ravel(), atol=1e-12)
    expected = rows.T @ curvature.dense() @ rows
    np.testing.assert_allclose(grouped.pulled_curvature(curvature), expected, atol=1e-11)


def test_fewer_unknowns(slopes, curvature, rng):
    whole, grouped = slopes
    directions = np.zeros((PARAMETERS, 4))
    directions[0, 0] = 1.0
    directions[3:, 1:] = rng.normal(size=(4, 3))
    narrow = grouped.narrowed(lambda rows: rows @ directions)
    rows = whole.reshape(3 * POINTS, PARAMETERS) @ directions
    np.testing.assert_allclose(narrow.dense(), rows, atol=1e-12)
    expected = rows.T @ curvature.dense() @ rows
    np.testing.assert_allclose(narrow.pulled_curvature(curvature), expected, atol=1e-11)


def test_a_coupling_out_of_a_group_is_refused(slopes):
    _, grouped = slopes
    far = sp.lil_matrix((POINTS, POINTS))
    far[0, POINTS - 1] = far[POINTS - 1, 0] = 1.0
    matrix = (CHAIN + far).tocsr()
    blocks = sp.kron(matrix, np.eye(3)).tobsr((3, 3))
    for curvature in (PerAxisCurvature(matrix), BlockCurvature(blocks.indptr, blocks.indices, blocks.data)):
        with pytest.raises(ValueError, match="couples a point of a group to one whose slopes"):
            grouped.pulled_curvature(curvature)
