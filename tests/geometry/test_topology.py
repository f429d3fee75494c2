"""Topology and normals: against libigl, and the invariants of closed and cut surfaces."""

import igl
import numpy as np
import pytest
import trimesh

from corporeal.geometry import normals, topology


def icosphere(subdivisions: int = 3) -> tuple[np.ndarray, np.ndarray]:
    mesh = trimesh.creation.icosphere(subdivisions)
    return np.array(mesh.vertices), np.array(mesh.faces, dtype=np.int64)


def open_sphere() -> tuple[np.ndarray, np.ndarray]:
    """A sphere without its caps above z = 0.8 and below z = -0.7: two holes."""
    vertices, faces = icosphere()
    height = vertices[faces].mean(axis=1)[:, 2]
    return vertices, faces[(height < 0.8) & (height > -0.7)]


def soup(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return vertices[faces].reshape(-1, 3), np.arange(faces.size).reshape(-1, 3)


def test_edges_agree_with_libigl_and_euler() -> None:
    vertices, faces = icosphere()
    edges = topology.unique_edges(faces)
    expected = np.sort(igl.edges(faces), axis=1)
    np.testing.assert_array_equal(edges, expected[np.lexsort(expected.T[::-1])])
    assert len(vertices) - len(edges) + len(faces) == 2


def test_boundary_loops_follow_the_faces_and_bound_every_hole() -> None:
    _, faces = open_sphere()
    loops = topology.boundary_loops(faces)
    assert len(loops) == 2
    assert len(loops[0]) >= len(loops[1])
    walked = np.concatenate([np.stack([loop, np.roll(loop, -1)], axis=1) for loop in loops])
    edges = topology.boundary_edges(faces)
    assert {tuple(edge) for edge in walked.tolist()} == {tuple(edge) for edge in edges.tolist()}
    assert len(walked) == len(edges)
    expected = igl.boundary_facets(faces)[0]
    assert {frozenset(e) for e in expected.tolist()} == {frozenset(e) for e in edges.tolist()}


def test_a_closed_surface_has_no_boundary() -> None:
    _, faces = icosphere()
    assert topology.boundary_loops(faces) == []
    assert topology.boundary_edges(faces).shape == (0, 2)
    assert topology.boundary_loops(np.zeros((0, 3), dtype=np.int64)) == []


def test_loops_that_touch_in_a_vertex_are_told_apart() -> None:
    fan = np.array([[0, 1, 2], [0, 3, 4]])  # two triangles that share vertex 0 alone
    loops = topology.boundary_loops(fan)
    assert sorted(sorted(loop.tolist()) for loop in loops) == [[0, 1, 2], [0, 3, 4]]


def test_a_boundary_that_does_not_close_is_refused() -> None:
    with pytest.raises(ValueError, match="does not close"):
        topology.boundary_loops(np.array([[0, 1, 2], [1, 2, 3]]))  # the shared edge runs the same way twice


def test_manifold_is_told_from_a_fin_and_from_a_flipped_face() -> None:
    _, faces = icosphere(1)
    assert topology.is_edge_manifold(faces)
    assert topology.is_edge_manifold(faces[1:])
    flipped = faces.copy()
    flipped[0] = flipped[0, ::-1]
    assert not topology.is_edge_manifold(flipped)
    fin = np.concatenate([faces, [[faces[0, 0], faces[0, 1], len(faces)]]])
    assert not topology.is_edge_manifold(fin)
    assert not topology.is_edge_manifold(np.array([[0, 0, 1]]))


def test_adjacent_faces_share_an_edge_and_none_is_missed() -> None:
    _, faces = open_sphere()
    pairs = topology.face_adjacency(faces)
    shared = [len(set(faces[a]) & set(faces[b])) for a, b in pairs]
    assert shared == [2] * len(pairs)
    interior = len(topology.unique_edges(faces)) - len(topology.boundary_edges(faces))
    assert len({frozenset(pair) for pair in pairs.tolist()}) == interior


def test_components_by_falling_size() -> None:
    small, large = icosphere(1)[1], icosphere(2)[1]
    faces = np.concatenate([small, large + small.max() + 1])
    count = int(faces.max()) + 2  # one vertex without a face
    labels = topology.connected_components(faces, count)
    np.testing.assert_array_equal(labels[faces[: len(small)]], 1)
    np.testing.assert_array_equal(labels[faces[len(small) :]], 0)
    assert labels[-1] == 2


@pytest.mark.parametrize("tolerance", [0.0, 1e-6])
def test_welding_a_soup_gives_the_mesh_back(rng: np.random.Generator, tolerance: float) -> None:
    vertices, faces = open_sphere()
    vertices, faces, _ = topology.remove_unreferenced(vertices, faces)
    loose, loose_faces = soup(vertices, faces)
    loose = loose + rng.uniform(-0.4, 0.4, loose.shape) * tolerance
    welded, welded_faces, new_index = topology.weld(loose, loose_faces, tolerance)
    assert len(welded) == len(vertices)
    assert len(topology.unique_edges(welded_faces)) == len(topology.unique_edges(faces))
    np.testing.assert_allclose(welded[welded_faces], vertices[faces], atol=tolerance)
    np.testing.assert_allclose(welded[new_index], loose, atol=tolerance)


@pytest.mark.parametrize("close", [0, 1, 30])
@pytest.mark.parametrize("flat", [False, True])
def test_welding_is_the_same_the_short_way_and_the_long_one(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch, close: int, flat: bool
) -> None:
    """A plane across x is where the short way gives up; neighbours in x alone must not be welded."""
    vertices = rng.uniform(0, 1, (400, 3))
    if flat:
        vertices[:, 0] = 0.5
    vertices[rng.choice(200, close, replace=False)] = vertices[200 : 200 + close] + 0.4e-5
    faces = rng.integers(0, 400, (300, 3))
    short = topology.weld(vertices, faces, 1e-5)
    monkeypatch.setattr(topology, "_LOOKED_AHEAD", 1)
    for found, expected in zip(short, topology.weld(vertices, faces, 1e-5), strict=True):
        np.testing.assert_array_equal(found, expected)
    assert (len(short[0]) < 400) == (close > 0)


def test_welding_drops_collapsed_faces_and_leaves_far_vertices_alone() -> None:
    vertices = np.array([[0, 0, 0], [1, 0, 0], [1 + 1e-5, 0, 0], [0, 1, 0.0]])
    faces = np.array([[0, 1, 3], [1, 2, 3]])
    welded, kept, new_index = topology.weld(vertices, faces, 1e-4)
    np.testing.assert_array_equal(new_index, [0, 1, 1, 2])
    np.testing.assert_array_equal(kept, [[0, 1, 2]])
    np.testing.assert_array_equal(welded, vertices[[0, 1, 3]])
    assert len(topology.weld(vertices, faces, 1e-6)[0]) == 4


@pytest.mark.parametrize("tolerance", [-1.0, np.nan, np.inf])
def test_a_senseless_tolerance_is_refused(tolerance: float) -> None:
    with pytest.raises(ValueError, match="tolerance"):
        topology.weld(np.zeros((3, 3)), np.array([[0, 1, 2]]), tolerance)


def test_unreferenced_vertices_go_and_the_shape_stays(rng: np.random.Generator) -> None:
    vertices, faces = icosphere(1)
    extended = np.concatenate([rng.normal(size=(5, 3)), vertices, rng.normal(size=(2, 3))])
    kept_vertices, kept_faces, kept = topology.remove_unreferenced(extended, faces + 5)
    np.testing.assert_array_equal(kept_vertices, vertices)
    np.testing.assert_array_equal(kept_faces, faces)
    np.testing.assert_array_equal(kept, np.arange(5, 5 + len(vertices)))


def test_volume_of_closed_turned_and_moved_surfaces() -> None:
    box = trimesh.creation.box((1, 2, 3))
    vertices, faces = np.array(box.vertices), np.array(box.faces)
    assert topology.signed_volume(vertices, faces) == pytest.approx(6)
    assert topology.signed_volume(vertices + 1e3, faces) == pytest.approx(6)
    assert topology.signed_volume(vertices, faces[:, ::-1]) == pytest.approx(-6)
    assert topology.signed_volume(*open_sphere()) > 0


def test_fans_close_every_hole_with_matching_winding() -> None:
    vertices, faces = open_sphere()
    capped_vertices, capped = topology.capped_by_fans(vertices, faces)
    assert topology.boundary_loops(capped) == []
    assert topology.is_edge_manifold(capped)
    np.testing.assert_array_equal(capped[: len(faces)], faces)
    assert len(capped_vertices) == len(vertices) + 2
    assert 3.0 < topology.signed_volume(capped_vertices, capped) < 4 * np.pi / 3


def test_normals_agree_with_libigl(rng: np.random.Generator) -> None:
    vertices, faces = open_sphere()
    vertices, faces, _ = topology.remove_unreferenced(vertices, faces)
    vertices = vertices * [1, 0.5, 2] + rng.normal(scale=0.01, size=vertices.shape)
    expected = igl.per_vertex_normals(vertices, faces, igl.PER_VERTEX_NORMALS_WEIGHTING_TYPE_ANGLE)
    np.testing.assert_allclose(normals.vertex_normals(vertices, faces), expected, atol=1e-9)
    np.testing.assert_allclose(2 * normals.face_areas(vertices, faces), igl.doublearea(vertices, faces))
    face_normals = normals.face_normals(vertices, faces)
    np.testing.assert_allclose(face_normals, igl.per_face_normals(vertices, faces, np.zeros(3)), atol=1e-12)


def test_normals_without_an_area_are_zero_and_not_nan() -> None:
    vertices = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [5, 5, 5.0]])
    faces = np.array([[0, 1, 2], [0, 0, 1]])
    np.testing.assert_array_equal(normals.face_normals(vertices, faces), 0)
    np.testing.assert_array_equal(normals.vertex_normals(vertices, faces), 0)


def test_open_sides_are_those_opposite_the_corners_of_boundary_edges():
    # Two triangles that share the edge 1-2.
    faces = np.array([[0, 1, 2], [2, 1, 3]])
    assert topology.open_sides(faces).tolist() == [[False, True, True], [True, True, False]]
