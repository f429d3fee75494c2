"""Loop subdivision as a matrix."""

import numpy as np
import pytest
import trimesh

from corporeal.geometry.subdivision import loop_step, refined_places


def sphere(level=2):
    mesh = trimesh.creation.icosphere(level)
    return np.asarray(mesh.vertices, dtype=float), np.asarray(mesh.faces, dtype=np.int64)


def cap(level=2):
    """A sphere cut open: one border loop."""
    vertices, faces = sphere(level)
    faces = faces[(vertices[faces, 2] > -0.5).all(1)]
    used, faces = np.unique(faces, return_inverse=True)
    return vertices[used], faces.reshape(-1, 3)


@pytest.mark.parametrize("mesh", [sphere, cap])
def test_rows_sum_to_one_and_are_not_negative(mesh):
    vertices, faces = mesh()
    step = loop_step(faces, len(vertices))
    np.testing.assert_allclose(step.matrix.sum(1), 1, atol=1e-12)
    assert step.matrix.min() >= 0


@pytest.mark.parametrize("mesh", [sphere, cap])
def test_affine_maps_commute_with_it(mesh, rng):
    vertices, faces = mesh()
    step = loop_step(faces, len(vertices))
    A, b = rng.normal(size=(3, 3)), rng.normal(size=3)
    np.testing.assert_allclose(step(vertices @ A + b), step(vertices) @ A + b, atol=1e-12)


def test_a_flat_sheet_stays_flat_and_keeps_its_border():
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0], [1, 1, 0], [2, 1, 0]])
    faces = np.array([[0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4]])
    fine = loop_step(faces, 6)(vertices)
    np.testing.assert_allclose(fine[:, 2], 0, atol=1e-15)
    np.testing.assert_allclose(fine[1], [1, 0, 0], atol=1e-15)


def test_it_keeps_topology_and_orientation():
    vertices, faces = cap()
    step = loop_step(faces, len(vertices))
    fine = trimesh.Trimesh(step(vertices), step.faces, process=False)
    coarse = trimesh.Trimesh(vertices, faces, process=False)
    assert fine.euler_number == coarse.euler_number
    assert fine.is_winding_consistent
    assert len(step.faces) == 4 * len(faces)


def test_an_edge_of_three_faces_is_refused():
    with pytest.raises(ValueError, match="more than two faces"):
        loop_step(np.array([[0, 1, 2], [1, 0, 3], [0, 1, 4]]), 5)


def test_refined_places_are_the_same_points_of_the_unmoved_surface(rng):
    vertices, faces = cap()
    face = rng.integers(0, len(faces), 400)
    weights = rng.dirichlet([0.5, 0.5, 0.5], 400)
    finer_face, finer_weights = refined_places(face, weights)
    step = loop_step(faces, len(vertices))
    # With every new vertex in the middle of its edge the surface does not move.
    middle = np.vstack([vertices, np.zeros((step.matrix.shape[0] - len(vertices), 3))])
    for a, b, c, (ab, bc, ca) in zip(*faces.T, step.faces[3::4], strict=True):
        middle[ab] = (vertices[a] + vertices[b]) / 2
        middle[bc] = (vertices[b] + vertices[c]) / 2
        middle[ca] = (vertices[c] + vertices[a]) / 2
    expected = np.einsum("nc,nca->na", weights, vertices[faces[face]])
    found = np.einsum("nc,nca->na", finer_weights, middle[step.faces[finer_face]])
    np.testing.assert_allclose(found, expected, atol=1e-12)
    assert finer_weights.min() > -1e-12
