"""Distances on a flat sheet, where they are known."""

import numpy as np
import pytest

from corporeal.geometry.closest_points import SurfaceTree
from corporeal.geometry.normals import face_normals
from corporeal.geometry.topology import open_sides
from corporeal.model.jacobian import evaluate
from corporeal.registration.measures import beyond_cut, mean_offsets, scan_to_mesh, surface_coverage
from corporeal.terms.scan_to_surface import MovingSurface
from corporeal.terms.surface_to_scan import ScanSurface

SIDE, STEP = 21, 2e-3


def sheet(side=SIDE, step=STEP):
    """A square of 40 mm in the plane z = 0, facing up."""
    x, y = np.meshgrid(np.arange(side) * step, np.arange(side) * step)
    points = np.stack([x.ravel(), y.ravel(), np.zeros(side**2)], axis=1)
    corner = (np.arange(side - 1)[:, None] * side + np.arange(side - 1)).ravel()
    faces = np.vstack(
        [np.stack([corner, corner + 1, corner + side], 1),
         np.stack([corner + 1, corner + side + 1, corner + side], 1)]
    )  # fmt: skip
    return points, faces.astype(np.int64)


def scan_surface(points, faces):
    return ScanSurface(SurfaceTree(points, faces), face_normals(points, faces), open_sides(faces))


def measured(points, normals=None, beyond=None):
    vertices, faces = sheet()
    kept = np.ones(len(points), dtype=bool) if beyond is None else beyond
    return scan_to_mesh(MovingSurface(vertices, faces), vertices, points, kept, normals)


def test_points_within_a_millimetre_of_the_open_boundary_are_not_scored(rng):
    points = np.column_stack([rng.uniform(-5e-3, 45e-3, (4000, 2)), rng.normal(0, 0.5e-3, 4000)])
    result = measured(points)
    foot = np.clip(points[:, :2], 0, 40e-3)
    inside = np.minimum(foot, 40e-3 - foot).min(axis=1)
    np.testing.assert_allclose(
        result.metres, np.hypot(np.linalg.norm(points[:, :2] - foot, axis=1), points[:, 2])
    )
    np.testing.assert_array_equal(result.scored, inside >= 1e-3)
    assert result.scored_share == pytest.approx((inside >= 1e-3).mean())


def test_points_before_the_cut_neither_count_nor_score():
    points = np.array([[0.02, 0.02, 1e-3], [0.02, 0.02, 5e-3], [0.02, 0.02, 3e-3], [0.0, 0.02, 9e-3]])
    result = measured(points, beyond=np.array([True, False, True, True]))
    assert result.scored.tolist() == [True, False, True, False]
    assert result.scored_share == pytest.approx(2 / 3)
    summary = result.summary_mm()
    found = (summary["mean"], summary["median"], summary["under_1mm"])
    assert found == pytest.approx((2.0, 2.0, 0.0), abs=1e-9)


def test_nothing_scored_is_not_a_number_and_never_good():
    result = measured(np.array([[0.0, 0.02, 0.0]]), beyond=np.array([False]))
    assert result.scored_share == 0.0
    assert np.isnan(result.summary_mm()["mean"]) and result.summary_mm()["scored_share"] == 0.0


def test_cosines_tell_points_that_face_the_other_way():
    points = np.array([[0.02, 0.02, 1e-3]] * 3)
    normals = np.array([[0, 0, 1.0], [0, 0, -1.0], [1.0, 0, 0]])
    np.testing.assert_allclose(measured(points, normals).cosines, [1, -1, 0], atol=1e-12)
    assert measured(points).cosines is None


def test_the_cut_keeps_the_models_own_side_with_a_margin(hand, rng):
    pose = np.zeros((hand.joint_count, 3))
    pose[0] = [0.4, -1.0, 0.3]
    posed = evaluate(hand, np.zeros(hand.shape_count), pose, np.array([0.1, -0.2, 0.3]))
    T = posed.T_world_joint[hand.cut.joint]
    n = T[:3, :3] @ hand.cut.normal
    origin = T[:3, :3] @ hand.cut.point + T[:3, 3]
    across = np.cross(n, rng.standard_normal((50, 3)))
    heights = rng.uniform(-0.02, 0.02, 50)
    points = origin + across + heights[:, None] * n
    np.testing.assert_array_equal(beyond_cut(points, hand.cut, posed), heights > 0)
    np.testing.assert_array_equal(beyond_cut(points, hand.cut, posed, 0.01), heights > -0.01)
    assert beyond_cut(points, None, posed).all()
    fingers = posed.vertices[hand.parts["index"]]
    assert beyond_cut(fingers, hand.cut, posed).all()


def test_mean_offsets_average_noise_away_and_keep_a_bump(rng):
    vertices, faces = sheet()
    points = np.column_stack([rng.uniform(2e-3, 38e-3, (60_000, 2)), rng.normal(0, 0.3e-3, 60_000)])
    bump = np.linalg.norm(points[:, :2] - 0.02, axis=1) < 6e-3
    points[bump, 2] += 2e-3
    offsets, counts = mean_offsets(measured(points), points, faces, len(vertices))
    assert counts.sum() == pytest.approx(measured(points).scored.sum())
    away = np.linalg.norm(vertices[:, :2] - 0.02, axis=1)
    assert np.abs(offsets[(away < 3e-3), 2] - 2e-3).max() < 0.15e-3
    flat = (away > 9e-3) & (counts > 50)
    assert np.abs(offsets[flat, 2]).max() < 0.15e-3 < np.abs(points[~bump, 2]).mean()


def test_coverage_tells_a_hole_from_a_contradiction():
    vertices, faces = sheet()
    centre = vertices[faces].mean(axis=1)
    holed = faces[(centre[:, 0] < 0.01) | (centre[:, 0] > 0.03)]
    hole = surface_coverage(vertices, faces, scan_surface(vertices, holed))
    assert hole.far_share == 0.0 and 0.25 < hole.hole_share < 0.45
    # A ridge of the mesh 5 mm above a whole scan: contradicted, not unseen.
    ridge = vertices.copy()
    ridge[np.abs(ridge[:, 0] - 0.02) < 5e-3, 2] = 5e-3
    raised = surface_coverage(ridge, faces, scan_surface(vertices, faces))
    assert raised.far_share > 0.1 and raised.hole_share < 0.05
    turned = surface_coverage(
        vertices + [0, 0, 5e-3], faces, scan_surface(vertices, np.ascontiguousarray(faces[:, ::-1]))
    )
    assert turned.far_share == 0.0 and turned.hole_share > 0.9
    same = surface_coverage(vertices, faces, scan_surface(vertices, faces))
    assert (same.far_share, same.hole_share) == (0.0, 0.0)
