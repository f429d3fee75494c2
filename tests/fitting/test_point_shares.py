"""What points of a scan weigh, and the surface that distances back go to: fine parts are heard."""

import dataclasses

import igl
import numpy as np
import pytest

from corporeal.fitting.frame_data import HandFaces, PointShares, chosen_points, frame_points
from corporeal.fitting.frame_fit import scan_surface
from corporeal.fitting.options import TrackingOptions
from corporeal.geometry.closest_points import SurfaceTree
from corporeal.geometry.normals import vertex_normals
from corporeal.model.files import open_model
from corporeal.scans.scan import Scan, Unit

OPTIONS = TrackingOptions()
PARTS = ("left_foot", "head", "left_calf", "right_thigh", "left_forearm")


@pytest.fixture(scope="module")
def body():
    return open_model("body")


@pytest.fixture(scope="module")
def scan(body):
    """The body's own surface, of 72,000 points."""
    vertices, faces = igl.upsample(body.template, body.faces)
    faces = faces.astype(np.int64)
    return Scan("itself", vertices, faces, vertex_normals(vertices, faces), None, Unit("m", 1.0))


@pytest.fixture(scope="module")
def sampled(body, scan):
    points = frame_points(scan, OPTIONS)
    return points, SurfaceTree(body.template, body.faces).closest(points.positions)


def _chosen(body, sampled, options):
    """Weights and faces of the points that are fitted to, and which faces are hands'."""
    points, closest = sampled
    hands = HandFaces.of_model(body).any_hand(len(body.faces))
    shares = PointShares.of_model(body, hands, options)
    own = np.ones(len(points.positions))
    kept, weights = chosen_points(closest, shares, own, options)
    return weights, closest.faces[kept], hands


def _per_vertex(body, sampled, options):
    """Weight per vertex of every part."""
    weights, faces, _ = _chosen(body, sampled, options)
    found = []
    for part in PARTS:
        own = np.zeros(body.vertex_count, dtype=bool)
        own[body.parts[part]] = True
        found.append(weights @ own[body.faces[faces]].mean(axis=1) / own.sum())
    return np.array(found)


def test_vertices_of_fine_parts_are_heard(body, sampled):
    by_vertex = _per_vertex(body, sampled, OPTIONS)
    fine, coarse = by_vertex[:2], by_vertex[2:]
    assert 0.5 * coarse.max() < fine.min()
    assert fine.max() < 3 * coarse.min()
    by_skin = _per_vertex(body, sampled, dataclasses.replace(OPTIONS, weigh_by_fineness=False))
    assert by_skin[0] < 0.3 * by_skin[2:].min()


def test_points_on_hands_weigh_what_the_options_say_however_fine_they_are(body, sampled):
    for fineness in (True, False):
        options = dataclasses.replace(OPTIONS, weigh_by_fineness=fineness)
        weights, faces, hands = _chosen(body, sampled, options)
        assert hands[faces].sum() > 1000
        np.testing.assert_allclose(weights[hands[faces]], options.hand_weight)


def test_the_surface_of_a_usual_scan_does_not_cut_across_toes(body, scan):
    surface = scan_surface(scan)
    toes = body.skinning_weights[:, body.joint_names.index("left_foot")] > 0.5
    millimetres = 1e3 * surface.tree.closest(body.template[toes]).distances
    assert millimetres.mean() < 0.5
