"""The stored base hand is whole and agrees with the open hand that was embedded in it."""

import hashlib
from importlib.resources import files

import numpy as np
import pytest

from corporeal.geometry.topology import boundary_loops
from corporeal.scans.simulation.files import HandSimulator, load_simulator


@pytest.fixture(scope="module")
def simulator() -> HandSimulator:
    return load_simulator()


def _volumes(vertices: np.ndarray, tets: np.ndarray) -> np.ndarray:
    corners = vertices[tets]
    return np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6


def _skin_of_tets(tets: np.ndarray) -> np.ndarray:
    sides = tets[:, [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]]].reshape(-1, 3)
    _, first, uses = np.unique(np.sort(sides, axis=1), axis=0, return_index=True, return_counts=True)
    assert uses.max() == 2
    return sides[first[uses == 1]]


def test_skin_is_one_sheet_with_one_opening_at_the_forearm(simulator):
    loops = boundary_loops(simulator.surface_faces)
    assert len(loops) == 1
    assert (simulator.surface_vertices[loops[0], 0] > 0.08).all()
    sides = simulator.surface_faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    assert len(np.unique(sides, axis=0)) == len(sides)
    edges = np.unique(np.sort(sides, axis=1), axis=0)
    # A disc: no handle joins two fingers.
    assert len(simulator.surface_vertices) - len(edges) + len(simulator.surface_faces) == 1
    assert len(np.unique(simulator.surface_faces)) == len(simulator.surface_vertices)


def test_weights_are_shares(simulator):
    assert (simulator.weights >= 0).all()
    np.testing.assert_allclose(simulator.weights.sum(1), 1, atol=1e-12)
    assert (simulator.weights.max(0) > 0.7).all()


def test_bones_are_the_familys_behind_a_forearm(simulator):
    assert simulator.parents.tolist() == [-1, 0, 1, 2, 3, 1, 5, 6, 1, 8, 9, 1, 11, 12, 1, 14, 15]
    np.testing.assert_allclose(simulator.joints[1], 0, atol=1e-9)
    fingers = simulator.joints[[4, 7, 10, 13]]
    assert (fingers[:, 0] < -0.09).all()
    index, middle, little, ring, thumb = simulator.joints[17:, 2]
    assert little < ring < middle < index < thumb


def test_axes_are_right_handed_and_lie_along_the_bones(simulator):
    axes = simulator.axes
    np.testing.assert_allclose(axes @ axes.transpose(0, 2, 1), np.tile(np.eye(3), (17, 1, 1)), atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(axes), 1)
    ends = np.array([3, 4, 17, 6, 7, 18, 9, 10, 19, 12, 13, 20, 15, 16, 21])
    bones = simulator.joints[ends] - simulator.joints[2:17]
    cosine = np.einsum("ba,ba->b", bones, axes[2:, 2]) / np.linalg.norm(bones, axis=1)
    assert np.rad2deg(np.arccos(cosine)).max() < 15


def test_tetrahedra_have_volume_and_fingers_of_their_own(simulator):
    volumes = _volumes(simulator.tet_vertices, simulator.tets)
    assert volumes.min() > 1e-10
    assert 12_000 <= len(simulator.tets) <= 25_000
    skin = _skin_of_tets(simulator.tets)
    edges = np.unique(
        np.sort(skin[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0, return_counts=True
    )
    assert (edges[1] == 2).all()
    # A ball: fingers that had grown together would make a handle.
    assert len(np.unique(skin)) - len(edges[0]) + len(skin) == 2


def test_skin_lies_within_a_third_of_a_millimetre_of_the_tetrahedra(simulator):
    from corporeal.geometry.closest_points import SurfaceTree

    found = SurfaceTree(simulator.tet_vertices, _skin_of_tets(simulator.tets)).closest(
        simulator.surface_vertices
    )
    assert found.distances.max() < 0.3e-3


def test_template_is_the_one_that_was_embedded(simulator):
    packed = files("corporeal") / "model" / "open_models" / "start_hand.npz"
    with packed.open("rb") as stream, np.load(stream) as model:
        template = np.ascontiguousarray(model["v_template"])
    assert hashlib.sha256(template.tobytes()).hexdigest() == simulator.template_sha256
    assert len(simulator.template_faces) == len(template)
    assert simulator.template_faces.max() < 4 * len(simulator.surface_faces)
    np.testing.assert_allclose(simulator.template_barycentric.sum(1), 1, atol=1e-12)
    assert simulator.template_barycentric.min() > -1e-6
