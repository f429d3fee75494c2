"""The embedded demo scan is what its builder says: noisy, holed, in millimetres, near its truth."""

from pathlib import Path

import numpy as np
import pytest

from corporeal.geometry.closest_points import SurfaceTree
from corporeal.geometry.topology import boundary_loops
from corporeal.scans.files import read_scan

DEMO = Path(__file__).parents[2] / "assets" / "demo"


@pytest.fixture(scope="module")
def scan():
    return read_scan(DEMO / "scan.ply")


def test_it_is_a_small_coloured_mesh_in_millimetres(scan):
    assert (DEMO / "scan.ply").stat().st_size < 600e3
    assert scan.unit.name == "mm" and scan.colours is not None
    assert 10_000 < len(scan.points) < 15_000


def test_it_has_holes_beside_the_open_arm(scan):
    assert len(boundary_loops(scan.faces)) >= 10


def test_its_noise_is_that_of_a_scanner(scan):
    truth = np.load(DEMO / "truth.npz")
    tree = SurfaceTree(truth["vertices_mm"].astype(float) * 1e-3, truth["faces"].astype(np.int64))
    distance = tree.closest(scan.points).distances
    assert 0.1e-3 < distance.mean() < 0.35e-3
    assert distance.max() < 2e-3
