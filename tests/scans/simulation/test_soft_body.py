"""Soft flesh on bones, on a bar with one hinge."""

import itertools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from corporeal.scans.simulation import flesh_kernels as kernels
from corporeal.scans.simulation.soft_body import FleshOptions, SoftBody
from corporeal.scans.simulation.tetrahedra import (
    boundary_faces,
    edge_matrices,
    laplacian,
    places,
    vertex_gradients,
)


def block(shape, size=3e-3):
    """A block of cubes, six tetrahedra each."""
    index = np.arange(np.prod(np.array(shape) + 1)).reshape(np.array(shape) + 1)
    points = np.stack(np.meshgrid(*(np.arange(n + 1) for n in shape), indexing="ij"), -1).reshape(-1, 3)
    tets = []
    for order in itertools.permutations(range(3)):
        corners = [np.zeros(3, int)]
        for axis in order:
            corners.append(corners[-1] + np.eye(3, dtype=int)[axis])
        cut = [index[tuple(slice(c[a], shape[a] + c[a]) for a in range(3))].ravel() for c in corners]
        tets.append(np.stack(cut, 1))
    tets = np.concatenate(tets)
    points = size * points.astype(float)
    flipped = np.linalg.det(edge_matrices(points, tets)) < 0
    tets[flipped] = tets[flipped][:, [1, 0, 2, 3]]
    return points - points.mean(0), tets


@pytest.fixture(scope="module")
def bar():
    points, tets = block((26, 5, 5))
    share = 1 / (1 + np.exp(-points[:, 0] / 3e-3))
    radius = np.hypot(points[:, 1], points[:, 2])
    bone = np.where((radius < 3.6e-3) & (np.abs(points[:, 0]) > 6e-3), (points[:, 0] > 0).astype(int), -1)
    weights = np.stack([1 - share, share], 1)
    options = FleshOptions(tolerance=0.005e-3)
    return SoftBody(points, tets, weights, bone, np.zeros(len(points), int), options)


def bent(degrees, steps=3):
    motions = np.tile(np.eye(4), (steps, 2, 1, 1))
    for k in range(steps):
        turn = np.deg2rad(degrees) * (k + 1) / steps
        motions[k, 1, :3, :3] = Rotation.from_rotvec([0, turn, 0]).as_matrix()
    return motions


def test_forces_are_the_gradient_of_the_energy(rng):
    points, tets = block((3, 3, 3), 1.0)
    edges = edge_matrices(points, tets)
    inverse, volumes = np.ascontiguousarray(np.linalg.inv(edges)), np.linalg.det(edges) / 6
    x = points + 0.25 * rng.normal(size=points.shape)

    def energy(p):
        gradient = np.zeros_like(p)
        value, _ = kernels.elastic_forces(p, tets, inverse, volumes, 4 / 3, 9.0, gradient)
        return value, gradient

    direction = rng.normal(size=x.shape)
    step = 1e-6
    difference = (energy(x + step * direction)[0] - energy(x - step * direction)[0]) / (2 * step)
    np.testing.assert_allclose(np.vdot(energy(x)[1], direction), difference, rtol=1e-7)
    assert np.abs(energy(points)[1]).max() < 1e-10


def test_contact_forces_are_the_gradient_of_their_energy(rng):
    x = rng.normal(size=(12, 3))
    vertices, triangles = np.arange(3), rng.integers(3, 12, (3, 3))
    weights, normals = rng.dirichlet([1, 1, 1], 3), rng.normal(size=(3, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)

    def energy(p):
        gradient = np.zeros_like(p)
        return kernels.contact_forces(
            p, vertices, triangles, weights, normals, np.ones(3), 5.0, gradient
        ), gradient

    direction = rng.normal(size=x.shape)
    step = 1e-6
    difference = (energy(x + step * direction)[0] - energy(x - step * direction)[0]) / (2 * step)
    np.testing.assert_allclose(np.vdot(energy(x)[1], direction), difference, rtol=1e-7)
    assert np.abs(energy(x)[1].sum(0)).max() < 1e-12


def test_a_rigid_motion_of_all_bones_moves_the_flesh_rigidly(bar):
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_rotvec([0.3, -0.5, 0.8]).as_matrix(), [0.02, 0.01, -0.03]
    posed = bar.posed(np.tile(T, (1, 2, 1, 1)))
    rest = bar.posed(np.tile(np.eye(4), (1, 2, 1, 1))).vertices
    np.testing.assert_allclose(posed.vertices, rest @ T[:3, :3].T + T[:3, 3], atol=1e-8)
    assert posed.volume_ratio == pytest.approx(1, abs=1e-9)


@pytest.mark.parametrize("degrees", [30, 60, 90])
def test_bending_keeps_volume_and_orientation_where_skinning_does_not(bar, degrees):
    motions = bent(degrees)
    posed = bar.posed(motions)
    assert posed.converged
    assert posed.smallest_det > 0.1
    assert abs(posed.volume_ratio - 1) < 0.02
    skinned = bar.skinned(motions[-1])
    assert np.linalg.norm(posed.vertices - skinned, axis=1).max() > 1e-3


def test_bending_the_other_way_is_the_mirror_image(bar):
    mirror = np.array([1.0, 1, -1])
    forth, back = bar.posed(bent(50)).vertices, bar.posed(bent(-50)).vertices
    rest = bar.posed(np.tile(np.eye(4), (1, 2, 1, 1))).vertices
    # The block's diagonals are not mirrored, so the two agree as well as 3 mm elements do.
    order = np.lexsort(np.round(rest / 1e-6).T)
    mirrored = np.lexsort(np.round(rest * mirror / 1e-6).T)
    apart = np.linalg.norm(back[order] - forth[mirrored] * mirror, axis=1)
    assert apart.max() < 1.2e-3
    assert apart.mean() < 0.2e-3


def test_two_fingers_press_on_each_other_without_passing_through():
    """Two bars 7 mm apart, pushed 10.5 mm against one another."""
    points, tets = block((12, 4, 4))
    gap = np.array([0.0007, 0.0009, 0.019])
    both = np.vstack([points, points + gap])
    cells = np.vstack([tets, tets + len(points)])
    part = np.repeat([0, 1], len(points))
    weights = np.eye(2)[part]
    radius = np.hypot(points[:, 1], points[:, 2])
    bone = np.where(np.tile(radius < 3.1e-3, 2), part, -1)
    motions = np.tile(np.eye(4), (4, 2, 1, 1))
    motions[:, 1, 2, 3] = -0.0105 * np.arange(1, 5) / 4
    core = np.abs(points[:, 0]) < 6e-3

    def lowest_of_the_upper(posed):
        return posed.vertices[len(points) :][core, 2].min()

    def top_of_the_lower(posed):
        return posed.vertices[: len(points)][core, 2].max()

    free = SoftBody(both, cells, weights, bone, part, FleshOptions(contact=0.0))
    pushed = SoftBody(both, cells, weights, bone, part)
    assert lowest_of_the_upper(free.posed(motions)) < top_of_the_lower(free.posed(motions)) - 3e-3
    posed = pushed.posed(motions)
    assert posed.deepest < 0.5e-3
    assert posed.smallest_det > 0
    assert lowest_of_the_upper(posed) > top_of_the_lower(posed) - 0.6e-3


def test_flat_elements_are_refused():
    points, tets = block((2, 2, 2))
    points[:, 2] = 0
    with pytest.raises(ValueError, match="flat or inverted"):
        SoftBody(
            points, tets, np.ones((len(points), 1)), np.zeros(len(points), int), np.zeros(len(points), int)
        )


def test_flesh_without_a_bone_is_refused():
    points, tets = block((2, 2, 2))
    with pytest.raises(ValueError, match="no vertex"):
        SoftBody(
            points, tets, np.ones((len(points), 1)), np.full(len(points), -1), np.zeros(len(points), int)
        )


def test_the_laplacian_knows_gradients(rng):
    points, tets = block((3, 4, 2), 0.1)
    matrix = laplacian(points, tets)
    slope = rng.normal(size=3)
    volume = np.linalg.det(edge_matrices(points, tets)).sum() / 6
    values = points @ slope + 3
    np.testing.assert_allclose(values @ matrix @ values, volume * slope @ slope, rtol=1e-10)


def test_places_and_gradients_reproduce_affine_maps(rng):
    points, tets = block((4, 3, 3), 1.0)
    inside = rng.uniform(-1, 1, (200, 3))
    tet, shares = places(inside, points, tets)
    np.testing.assert_allclose(np.einsum("nc,nca->na", shares, points[tets[tet]]), inside, atol=1e-12)
    assert shares.min() > -1e-9
    A = rng.normal(size=(3, 3)) + 2 * np.eye(3)
    gradients = vertex_gradients(points, points @ A.T, tets)
    np.testing.assert_allclose(gradients, np.tile(A, (len(points), 1, 1)), atol=1e-10)


def test_the_boundary_is_closed_and_looks_outwards():
    points, tets = block((3, 2, 2), 1.0)
    faces = boundary_faces(tets)
    corners = points[faces]
    volume = np.einsum("fa,fa->f", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6
    np.testing.assert_allclose(volume, 12.0, rtol=1e-12)
