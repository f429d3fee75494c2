"""Flat cuts are found, hands are not called flat."""

import numpy as np
import pytest
import trimesh

from corporeal.geometry.normals import face_areas, vertex_normals
from corporeal.model.files import open_model
from corporeal.scans.files import read_scan
from corporeal.scans.flat_patches import flat_patch
from corporeal.scans.scan import Scan, Unit


def _scan(vertices, faces):
    faces = np.asarray(faces, dtype=np.int64)
    return Scan("scan", vertices, faces, vertex_normals(vertices, faces), None, Unit("m", 1.0))


def test_the_base_of_a_cone_is_found_whatever_its_place(rng):
    cone = trimesh.creation.cone(radius=0.05, height=0.1, sections=96)
    R = trimesh.transformations.random_rotation_matrix(rng.random(3))[:3, :3]
    scan = _scan(np.asarray(cone.vertices) @ R.T + 0.3, cone.faces)
    base = np.abs(cone.vertices[cone.faces][:, :, 2]).max(axis=1) < 1e-9
    assert base.any() and np.array_equal(flat_patch(scan), base)


def test_a_hand_has_no_flat_patch():
    hand = open_model("hand")
    assert not flat_patch(_scan(hand.template, hand.faces)).any()


@pytest.mark.parametrize(
    ("file", "share"),
    [("hand-scan2knit/hand5.off", 0.0), ("hand-sense/hand3.stl", 0.0), ("hand-sense/hand1.stl", 0.30)],
)
def test_of_the_real_scans_only_the_partial_one_was_cut(shared_data, file, share):
    scan = read_scan(shared_data / "scans" / file)
    areas = face_areas(scan.points, scan.faces)
    assert areas[flat_patch(scan)].sum() / areas.sum() == pytest.approx(share, abs=0.02)


def test_a_point_cloud_has_none():
    points = np.random.default_rng(0).normal(size=(100, 3))
    cloud = Scan("cloud", points, np.zeros((0, 3), np.int64), points, None, Unit("m", 1.0))
    assert flat_patch(cloud).shape == (0,)
