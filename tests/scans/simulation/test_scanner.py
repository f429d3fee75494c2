"""The virtual scanner against what its options promise, with a ray caster of the test's own."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from corporeal.geometry.closest_points import SurfaceTree
from corporeal.geometry.normals import face_normals, vertex_normals
from corporeal.geometry.self_intersection import winding_numbers
from corporeal.geometry.subdivision import loop_step
from corporeal.scans.segmentation import object_mask
from corporeal.scans.simulation.appearance import SKIN_TONES, skin_colours
from corporeal.scans.simulation.files import load_simulator
from corporeal.scans.simulation.props import hand_stand, held_object
from corporeal.scans.simulation.sampling_pattern import sampling_pattern
from corporeal.scans.simulation.scanner import (
    RawCapture,
    SampledSurface,
    ScannerOptions,
    scan_surface,
    stereo_units,
)
from corporeal.scans.simulation.skeleton import bone_transforms

UPRIGHT = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])


@pytest.fixture(scope="module")
def hand() -> SampledSurface:
    simulator = load_simulator()
    fine = loop_step(simulator.surface_faces, len(simulator.surface_vertices))
    rest = fine(simulator.surface_vertices)
    pattern = sampling_pattern(rest, fine.faces, 50_000, np.random.default_rng(5))
    colours = skin_colours(rest, vertex_normals(rest, fine.faces), len(SKIN_TONES) - 1, 3)
    return SampledSurface(rest @ UPRIGHT.T, fine.faces, colours, pattern)


@pytest.fixture(scope="module")
def stand() -> SampledSurface:
    joints = load_simulator().joints @ UPRIGHT.T
    return hand_stand(joints[0], joints[1])


@pytest.fixture(scope="module")
def capture(hand: SampledSurface, stand: SampledSurface) -> RawCapture:
    return scan_surface(hand, [stand], ScannerOptions(), np.random.default_rng(11))


def test_has_as_many_points_as_a_commercial_scan(capture: RawCapture) -> None:
    assert 40_000 < len(capture.points) < 60_000
    assert 1.8 < len(capture.faces) / len(capture.points) < 2.0
    assert np.array_equal(np.unique(capture.faces), np.arange(len(capture.points)))


def test_noise_is_as_large_as_asked_for(capture: RawCapture) -> None:
    distances = np.linalg.norm(capture.points - capture.clean, axis=1)
    assert np.sqrt(np.mean(distances**2)) == pytest.approx(0.2e-3, rel=0.05)
    assert distances.max() < 2.5e-3


def test_noise_of_neighbours_is_a_little_alike(capture: RawCapture) -> None:
    noise = np.linalg.norm(capture.points - capture.clean, axis=1)
    sign = np.sign(((capture.points - capture.clean) * vertex_normals(capture.clean, capture.faces)).sum(1))
    a, b = (sign * noise)[capture.faces[:, :2]].T
    assert 0.1 < np.corrcoef(a, b)[0, 1] < 0.8


def test_clean_points_lie_on_the_surface_but_not_on_its_vertices(hand: SampledSurface) -> None:
    clean = scan_surface(hand, [], ScannerOptions(), np.random.default_rng(12)).clean
    assert SurfaceTree(hand.vertices, hand.faces).closest(clean).distances.max() < 1e-9
    gaps = np.linalg.norm(clean - hand.vertices[_nearest(hand.vertices, clean)], axis=1)
    assert (gaps < 2e-6).mean() < 1e-4


def test_kept_points_are_seen_by_both_cameras_of_a_unit(
    hand: SampledSurface, rng: np.random.Generator
) -> None:
    options = ScannerOptions()
    clean = scan_surface(hand, [], options, np.random.default_rng(13)).clean
    points = clean[rng.choice(len(clean), 60, replace=False)]
    units = stereo_units((hand.vertices.min(0) + hand.vertices.max(0)) / 2, options)
    seen = [
        any(all(_sees(camera.eye, point, hand.vertices, hand.faces) for camera in pair) for pair in units)
        for point in points
    ]
    # A picture's pixel is half a millimetre: a few points behind a rim pass.
    assert np.mean(seen) > 0.96


def test_same_state_same_scan_and_other_state_other_points(
    hand: SampledSurface, stand: SampledSurface, capture: RawCapture
) -> None:
    again = scan_surface(hand, [stand], ScannerOptions(), np.random.default_rng(11))
    for name in ("points", "faces", "colours", "clean"):
        assert np.array_equal(getattr(again, name), getattr(capture, name)), name
    other = scan_surface(hand, [stand], ScannerOptions(), np.random.default_rng(14))
    gaps = np.linalg.norm(other.clean[_nearest(other.clean, capture.clean)] - capture.clean, axis=1)
    assert np.median(gaps) > 0.05e-3


def test_place_in_the_list_tells_nothing(capture: RawCapture) -> None:
    order = np.arange(len(capture.clean))
    for axis in range(3):
        assert abs(np.corrcoef(order, capture.clean[:, axis])[0, 1]) < 0.025
    steps = np.linalg.norm(np.diff(capture.clean, axis=0), axis=1)
    assert np.median(steps) > 0.03


def test_triangles_face_outwards(hand: SampledSurface) -> None:
    scan = scan_surface(hand, [], ScannerOptions(), np.random.default_rng(15))
    normals = vertex_normals(hand.vertices, hand.faces)[_nearest(hand.vertices, scan.clean)]
    facing = (face_normals(scan.clean, scan.faces) * normals[scan.faces].mean(1)).sum(1)
    assert (facing < 0).mean() < 2e-3


def test_darkest_skin_and_stand_are_not_green(capture: RawCapture) -> None:
    assert not object_mask(capture.colours).any()


def test_grasps_hold_green_objects_that_hardly_enter_the_hand() -> None:
    simulator = load_simulator()
    held = 0
    for number, bend in enumerate((20.0, 30.0, 40.0, 50.0, 60.0)):
        angles = np.zeros((17, 3))
        angles[2:14, 0], angles[14:, 0] = bend, 20.0
        motions = bone_transforms(simulator, simulator.joints, angles)
        R, t = motions[:, :3, :3], motions[:, :3, 3]
        skin = (
            np.einsum("nk,kab,nb->na", simulator.weights, R, simulator.surface_vertices)
            + simulator.weights @ t
        )
        joints = np.einsum("kab,kb->ka", R, simulator.joints[:17]) + t
        found = held_object(skin @ UPRIGHT.T, joints @ UPRIGHT.T, np.random.default_rng(number))
        if found is None:
            continue
        held += 1
        alone = scan_surface(found, [], ScannerOptions(), np.random.default_rng(number))
        assert object_mask(alone.colours).all()
        inside = np.abs(winding_numbers(skin @ UPRIGHT.T, found.vertices, found.faces)) > 0.5
        if inside.any():
            entered = (skin @ UPRIGHT.T)[inside]
            assert SurfaceTree(found.vertices, found.faces).closest(entered).distances.max() < 2e-3, bend
    assert held >= 4


def _nearest(targets: np.ndarray, points: np.ndarray) -> np.ndarray:
    return cKDTree(targets).query(points)[1]


def _sees(eye: np.ndarray, point: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> bool:
    """Nothing lies between eye and point, up to a millimetre before the point (Moeller and Trumbore 1997)."""
    ray = point - eye
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    first, second = b - a, c - a
    h = np.cross(ray, second)
    determinant = (first * h).sum(1)
    determinant[np.abs(determinant) < 1e-16] = np.inf
    s = eye - a
    u = (s * h).sum(1) / determinant
    q = np.cross(s, first)
    v = (q @ ray) / determinant
    t = (second * q).sum(1) / determinant
    margin = 1e-3 / np.linalg.norm(ray)
    return not ((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0) & (t < 1 - margin)).any()
