"""Closest points: against libigl and exact arithmetic; refit, warm start and motion change nothing."""

import itertools
from fractions import Fraction

import igl
import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from corporeal.geometry.closest_points import ClosestPoints, SurfaceTree


def bumpy_sphere(rng: np.random.Generator, subdivisions: int = 4) -> tuple[np.ndarray, np.ndarray]:
    """A hand-sized deformed sphere in metres: 5,120 faces by default."""
    mesh = trimesh.creation.icosphere(subdivisions)
    directions = np.array(mesh.vertices)
    radius = 0.08 * (1 + 0.3 * np.sin(4 * directions @ rng.normal(size=(3, 2))).prod(axis=1))
    return directions * radius[:, None] * [1, 0.6, 1.4], np.array(mesh.faces, dtype=np.int64)


def points_around(rng: np.random.Generator, vertices: np.ndarray, count: int) -> np.ndarray:
    """On the surface, near it, inside, around and far away."""
    anchors = vertices[rng.integers(len(vertices), size=count)]
    scale = rng.choice([0, 1e-6, 2e-3, 5e-2, 1, 100], size=(count, 1))
    return anchors + scale * rng.normal(size=(count, 3))


def assert_consistent(answer: ClosestPoints, points, vertices, faces) -> None:
    """The parts of an answer describe one point of the surface."""
    assert (answer.barycentric >= 0).all()
    np.testing.assert_allclose(answer.barycentric.sum(axis=1), 1, atol=1e-14)
    interpolated = np.einsum("nc,ncd->nd", answer.barycentric, vertices[faces[answer.faces]])
    np.testing.assert_allclose(answer.points, interpolated, atol=1e-15)
    scale = np.abs(points).max()
    distances = np.linalg.norm(answer.points - points, axis=1)
    np.testing.assert_allclose(distances, answer.distances, rtol=1e-9, atol=1e-14 * scale)


def assert_same(answer: ClosestPoints, other: ClosestPoints) -> None:
    np.testing.assert_array_equal(answer.faces, other.faces)
    np.testing.assert_array_equal(answer.barycentric, other.barycentric)
    np.testing.assert_array_equal(answer.squared_distances, other.squared_distances)


def exact_squared_distance(point: np.ndarray, triangle: np.ndarray) -> Fraction:
    """In rational arithmetic: the least over corners, edges and, if the foot is inside, the plane."""
    corners = [[Fraction(float(value)) for value in corner] for corner in triangle]
    p = [Fraction(float(value)) for value in point]

    def difference(a, b):
        return [x - y for x, y in zip(a, b, strict=True)]

    def dot(a, b):
        return sum(x * y for x, y in zip(a, b, strict=True))

    def squared(a, b):
        return dot(difference(a, b), difference(a, b))

    candidates = [squared(p, corner) for corner in corners]
    for a, b in itertools.combinations(corners, 2):
        edge, length = difference(b, a), squared(a, b)
        if length > 0:
            s = min(max(dot(difference(p, a), edge) / length, Fraction(0)), Fraction(1))
            candidates.append(squared(p, [x + s * e for x, e in zip(a, edge, strict=True)]))
    ab, ac, ap = (difference(q, corners[0]) for q in (corners[1], corners[2], p))
    determinant = dot(ab, ab) * dot(ac, ac) - dot(ab, ac) ** 2
    if determinant > 0:
        v = (dot(ac, ac) * dot(ap, ab) - dot(ab, ac) * dot(ap, ac)) / determinant
        w = (dot(ab, ab) * dot(ap, ac) - dot(ab, ac) * dot(ap, ab)) / determinant
        if v >= 0 and w >= 0 and v + w <= 1:
            foot = [a + v * x + w * y for a, x, y in zip(corners[0], ab, ac, strict=True)]
            candidates.append(squared(p, foot))
    return min(candidates)


@pytest.mark.parametrize("count", [1, 700, 20_000])
def test_distances_agree_with_libigl(rng: np.random.Generator, count: int) -> None:
    vertices, faces = bumpy_sphere(rng)
    points = points_around(rng, vertices, count)
    answer = SurfaceTree(vertices, faces).closest(points)
    expected = np.sqrt(igl.point_mesh_squared_distance(points, vertices, faces)[0])
    np.testing.assert_allclose(answer.distances, expected, rtol=1e-9, atol=1e-12)
    assert_consistent(answer, points, vertices, faces)


def test_every_shape_of_triangle_against_exact_arithmetic(rng: np.random.Generator) -> None:
    for _ in range(60):
        triangle = rng.normal(size=(3, 3))
        for flatness in (1, 1e-3, 1e-5, 1e-8, 1e-12, 0):
            # Corner c slides towards the line ab, inside and outside of the edge: slivers of every kind.
            along = rng.uniform(-0.5, 1.5)
            flat = triangle.copy()
            flat[2] = triangle[0] + along * (triangle[1] - triangle[0]) + flatness * triangle[2]
            flat = flat[rng.permutation(3)]
            points = flat.mean(axis=0) + rng.normal(size=(4, 3)) * rng.choice([1e-6, 0.1, 3], size=(4, 1))
            answer = SurfaceTree(flat, np.array([[0, 1, 2]])).closest(points)
            assert_consistent(answer, points, flat, np.array([[0, 1, 2]]))
            exact = [float(exact_squared_distance(point, flat)) ** 0.5 for point in points]
            # The corners' own rounding turns a triangle of height h by 1e-16 / h; below that its edges do.
            tolerance = 1e-8 if 0 < flatness < 1e-3 else 1e-11
            np.testing.assert_allclose(answer.distances, exact, rtol=1e-9, atol=tolerance)


def test_faces_shrunk_to_a_segment_or_a_point_are_found() -> None:
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0.25, 0, 0], [5, 5, 5.0]])
    faces = np.array([[0, 1, 2], [3, 3, 3], [3, 0, 0]])
    answer = SurfaceTree(vertices, faces).closest(np.array([[0.7, -2, 0], [6, 5, 5], [2.5, 2.5, 2.5]]))
    np.testing.assert_allclose(answer.distances, [2, 1, 0], atol=1e-15)
    np.testing.assert_array_equal(answer.faces, [0, 1, 2])


def test_warm_start_from_any_face_changes_nothing(rng: np.random.Generator) -> None:
    vertices, faces = bumpy_sphere(rng)
    tree = SurfaceTree(vertices, faces)
    points = points_around(rng, vertices, 3000)
    cold = tree.closest(points)
    assert_same(tree.closest(points, cold.faces), cold)
    assert_same(tree.closest(points, rng.integers(-1, len(faces), size=len(points))), cold)
    part = slice(0, 500)  # few points are asked on one core and unsorted
    few = tree.closest(points[part], rng.integers(-1, len(faces), size=500))
    np.testing.assert_array_equal(few.faces, cold.faces[part])
    np.testing.assert_array_equal(few.squared_distances, cold.squared_distances[part])


def test_of_equally_close_faces_the_lowest_wins(rng: np.random.Generator) -> None:
    vertices, faces = bumpy_sphere(rng, 2)
    twice = np.concatenate([faces, faces])
    shuffled = twice[rng.permutation(len(twice))]
    points = points_around(rng, vertices, 2000)
    answer = SurfaceTree(vertices, shuffled).closest(points, rng.integers(len(twice), size=len(points)))
    first = np.array([np.flatnonzero((shuffled == face).all(axis=1))[0] for face in shuffled])
    np.testing.assert_array_equal(answer.faces, first[answer.faces])


def test_a_refitted_tree_answers_like_a_new_one(rng: np.random.Generator) -> None:
    vertices, faces = bumpy_sphere(rng)
    tree = SurfaceTree(vertices, faces)
    for amplitude in (0.001, 0.01, 0.05):
        moved = vertices + amplitude * np.sin(vertices[:, ::-1] * 40) + amplitude
        tree.refit(moved)
        points = points_around(rng, moved, 3000)
        assert_same_distances(tree.closest(points), SurfaceTree(moved, faces).closest(points))
        assert_consistent(tree.closest(points), points, moved, faces)


def assert_same_distances(answer: ClosestPoints, other: ClosestPoints) -> None:
    """A rebuilt tree computes the same numbers from the same triangles, wherever they stand."""
    np.testing.assert_array_equal(answer.squared_distances, other.squared_distances)
    np.testing.assert_array_equal(answer.faces, other.faces)


def test_a_tree_rebuilds_when_the_surface_is_scrambled_and_only_then(rng: np.random.Generator) -> None:
    vertices, faces = bumpy_sphere(rng)
    tree = SurfaceTree(vertices, faces)
    tree.refit(vertices + 1)
    tree.refit(vertices * 1000)
    tree.refit(Rotation.random(random_state=1).apply(vertices))
    tree.refit(vertices * [1, 1, 1.3])
    assert tree.rebuild_count == 0
    twist = Rotation.from_rotvec(np.outer(vertices[:, 2] * 60, [0, 0, 1]))
    moved = twist.apply(vertices)
    tree.refit(moved)
    assert tree.rebuild_count == 1
    tree.refit(moved)
    assert tree.rebuild_count == 1
    points = points_around(rng, moved, 2000)
    assert_same_distances(tree.closest(points), SurfaceTree(moved, faces).closest(points))


@pytest.mark.parametrize("scale", [1e-6, 1, 1e6])
def test_answers_move_with_the_scene(rng: np.random.Generator, scale: float) -> None:
    vertices, faces = bumpy_sphere(rng)
    points = vertices[rng.integers(len(vertices), size=2000)] + 0.01 * rng.normal(size=(2000, 3))
    before = SurfaceTree(vertices, faces).closest(points)
    turn = Rotation.random(random_state=3)
    shift = rng.normal(size=3)
    after = SurfaceTree(scale * (turn.apply(vertices) + shift), faces).closest(
        scale * (turn.apply(points) + shift)
    )
    np.testing.assert_allclose(after.distances, scale * before.distances, rtol=1e-9, atol=1e-14 * scale)
    np.testing.assert_allclose(after.points, scale * (turn.apply(before.points) + shift), atol=1e-7 * scale)


def test_the_callers_arrays_are_left_alone(rng: np.random.Generator) -> None:
    vertices, faces = bumpy_sphere(rng, 2)
    tree = SurfaceTree(vertices, faces)
    points = points_around(rng, vertices, 100)
    before = tree.closest(points)
    vertices += 1
    assert_same(tree.closest(points), before)
    np.testing.assert_array_equal(tree.closest(points).points, before.points)


def test_float32_and_int32_are_taken(rng: np.random.Generator) -> None:
    vertices, faces = bumpy_sphere(rng, 2)
    rounded = vertices.astype(np.float32)
    points = points_around(rng, vertices, 50).astype(np.float32)
    narrow = SurfaceTree(rounded, faces.astype(np.int32)).closest(points)
    wide = SurfaceTree(rounded.astype(np.float64), faces).closest(points.astype(np.float64))
    assert_same(narrow, wide)


def test_a_mesh_that_makes_the_deepest_tree(rng: np.random.Generator) -> None:
    """Triangles that halve in size towards the origin: each cut parts a few of them from all the rest."""
    sizes = np.repeat(0.5 ** np.arange(200.0), 3)
    vertices = np.concatenate([sizes[:, None] * (1 + rng.uniform(size=(len(sizes), 3)) * 0.2)])
    faces = np.arange(len(sizes)).reshape(-1, 3)
    points = np.concatenate(
        [rng.normal(size=(1500, 3)) * 0.5 ** rng.uniform(0, 100, size=(1500, 1)), vertices]
    )
    answer = SurfaceTree(vertices, faces).closest(points)
    every = np.array(
        [SurfaceTree(vertices, faces[[f]]).closest(points).squared_distances for f in range(200)]
    )
    np.testing.assert_array_equal(answer.squared_distances, every.min(axis=0))


def test_points_beyond_float32_are_answered(rng: np.random.Generator) -> None:
    vertices, faces = bumpy_sphere(rng, 2)
    points = rng.normal(size=(50, 3)) * 1e25
    answer = SurfaceTree(vertices, faces).closest(points)
    np.testing.assert_allclose(answer.distances, np.linalg.norm(points, axis=1), rtol=1e-12)


def test_no_points_give_an_empty_answer(rng: np.random.Generator) -> None:
    answer = SurfaceTree(*bumpy_sphere(rng, 1)).closest(np.zeros((0, 3)))
    assert answer.points.shape == (0, 3)


def test_senseless_input_is_refused_by_name(rng: np.random.Generator) -> None:
    vertices, faces = bumpy_sphere(rng, 1)
    with pytest.raises(ValueError, match="no face"):
        SurfaceTree(vertices, faces[:0])
    with pytest.raises(ValueError, match="faces: expected indices"):
        SurfaceTree(vertices, faces + 1)
    broken = vertices.copy()
    broken[7, 1] = np.nan
    with pytest.raises(ValueError, match="vertex 7 is not finite"):
        SurfaceTree(broken, faces)
    tree = SurfaceTree(vertices, faces)
    with pytest.raises(ValueError, match="vertex 7 is not finite"):
        tree.refit(broken)
    with pytest.raises(ValueError, match="another topology"):
        tree.refit(vertices[1:])
    with pytest.raises(ValueError, match="point 7 is not finite"):
        tree.closest(broken)
    with pytest.raises(ValueError, match="start"):
        tree.closest(vertices, np.full(len(vertices), len(faces)))
