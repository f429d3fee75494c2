"""Skin in tetrahedra follows them, and they follow it, without facets or drift."""

import itertools

import numpy as np
import pytest

from corporeal.scans.simulation.embedded_skin import EmbeddedSkin
from corporeal.scans.simulation.tetrahedra import edge_matrices


@pytest.fixture(scope="module")
def grid():
    """A unit cube of 6 x 6 x 6 cells in tetrahedra, and points inside it and a little outside."""
    count = 6
    index = np.arange((count + 1) ** 3).reshape((count + 1,) * 3)
    steps = np.linspace(0, 1, count + 1)
    points = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), -1).reshape(-1, 3)
    tets = []
    for order in itertools.permutations(range(3)):
        corners = [np.zeros(3, int)]
        for axis in order:
            corners.append(corners[-1] + np.eye(3, dtype=int)[axis])
        cut = [index[tuple(slice(c[a], count + c[a]) for a in range(3))].ravel() for c in corners]
        tets.append(np.stack(cut, 1))
    tets = np.concatenate(tets)
    flipped = np.linalg.det(edge_matrices(points, tets)) < 0
    tets[flipped] = tets[flipped][:, [1, 0, 2, 3]]
    surface = np.random.default_rng(4).uniform(-0.03, 1.03, size=(400, 3))
    return EmbeddedSkin(surface, points, tets)


def test_skin_follows_affine_motions_exactly(grid, rng):
    matrix, shift = rng.normal(size=(3, 3)), rng.normal(size=3)
    moved = grid.posed(grid.surface, grid.tet_vertices, grid.tet_vertices @ matrix.T + shift)
    np.testing.assert_allclose(moved, grid.surface @ matrix.T + shift, atol=1e-12)


def test_skin_has_no_facets(grid):
    def bent(points):
        return points + 0.3 * np.stack([points[:, 1] ** 2, points[:, 0] * points[:, 2], points[:, 0] ** 2], 1)

    # Gradients of vertices on the boundary are one-sided: away from it the motion is exact.
    inner = ((grid.surface > 0.2) & (grid.surface < 0.8)).all(1)
    assert inner.sum() > 20
    moved = grid.posed(grid.surface, grid.tet_vertices, bent(grid.tet_vertices))
    np.testing.assert_allclose(moved[inner], bent(grid.surface)[inner], atol=3e-4)


def test_tetrahedra_follow_skin_that_moves_as_one(grid):
    other = grid.rest_of(grid.surface + [0.1, -0.2, 0.3])
    np.testing.assert_allclose(other, grid.tet_vertices + [0.1, -0.2, 0.3], atol=1e-9)


def test_weights_are_shares(grid):
    own = np.stack([grid.surface[:, 0] < 0.5, grid.surface[:, 0] >= 0.5], 1).astype(float)
    spread = grid.weights(own)
    assert (spread >= 0).all()
    np.testing.assert_allclose(spread.sum(1), 1, atol=1e-12)
    assert (spread[grid.tet_vertices[:, 0] < 0.1, 0] > 0.8).all()
