"""Samples lie on the surface, evenly in area."""

import numpy as np
import pytest
import trimesh

from corporeal.geometry.normals import vertex_normals
from corporeal.scans.scan import Scan, Unit
from corporeal.scans.surface_sampling import sample_surface


def _scan(mesh):
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces, dtype=np.int64)
    return Scan("scan", vertices, faces, vertex_normals(vertices, faces), None, Unit("m", 1.0))


def test_samples_of_a_box_lie_on_it_and_share_its_area():
    # One side is cut into many triangles: they must not draw more samples.
    box = trimesh.creation.box([1.0, 2.0, 3.0])
    fine = box.subdivide(face_index=np.flatnonzero(box.face_normals[:, 0] > 0.5))
    points, normals = sample_surface(_scan(fine), 20_000, seed=1)
    on_side = np.abs(np.abs(points) / [0.5, 1.0, 1.5] - 1).min(axis=1)
    assert on_side.max() < 1e-12
    assert np.mean(normals[:, 0] > 0.5) == pytest.approx(6 / 22, abs=0.002)
    assert np.abs(np.linalg.norm(normals, axis=1) - 1).max() < 1e-12


def test_the_same_seed_gives_the_same_samples_and_the_order_is_random():
    scan = _scan(trimesh.creation.icosphere(subdivisions=3))
    first, second = (sample_surface(scan, 500, seed=4)[0] for _ in range(2))
    assert np.array_equal(first, second)
    # Any part of the samples is spread over the whole surface.
    assert np.abs(first[:100].mean(axis=0)).max() < 0.2


def test_a_cloud_gives_its_own_points(rng):
    points = rng.normal(size=(300, 3))
    cloud = Scan("cloud", points, np.zeros((0, 3), np.int64), points, None, Unit("m", 1.0))
    sampled, _ = sample_surface(cloud, 100)
    assert len(sampled) == 100
    assert {tuple(p) for p in sampled} <= {tuple(p) for p in points}


def test_a_count_below_one_is_refused():
    with pytest.raises(ValueError, match="at least 1"):
        sample_surface(_scan(trimesh.creation.box()), 0)
