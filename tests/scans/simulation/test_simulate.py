"""Sessions and their scans: who does what, the same numbers each time, and what the truth says."""

import numpy as np
import pytest
import trimesh

from corporeal.geometry.closest_points import SurfaceTree
from corporeal.geometry.subdivision import loop_step
from corporeal.scans.simulation.files import load_simulator
from corporeal.scans.simulation.hand_flesh import SoftHand
from corporeal.scans.simulation.identities import hand_at_rest, sample_subjects
from corporeal.scans.simulation.protocol import protocol_poses
from corporeal.scans.simulation.simulate import PlannedScan, SimulationOptions, plan_session, simulate_scan

pytestmark = pytest.mark.slow
OPTIONS = SimulationOptions(subjects=2, seed=3)


@pytest.fixture(scope="module")
def hand():
    simulator = load_simulator()
    subject = sample_subjects(simulator, 1, 11)[0]
    return SoftHand(simulator, *hand_at_rest(simulator, subject, "right"))


@pytest.fixture(scope="module")
def pair():
    """The same pose of one person's right and left hand."""
    name = protocol_poses()[20].name
    return [
        simulate_scan(PlannedScan(f"s01_p21_{side}", 0, side, name, ""), OPTIONS)
        for side in ("right", "left")
    ]


def test_a_full_session_has_two_thousand_scans_and_one_in_forty_is_bad():
    plan = plan_session(SimulationOptions())
    assert 1900 < len(plan) < 2100
    assert len({scan.name for scan in plan}) == len(plan)
    assert 0.015 < np.mean([scan.fault != "" for scan in plan]) < 0.035
    assert {scan.fault for scan in plan} == {"", "moved", "half", "empty", "nan", "truncated"}
    assert 0.1 < np.mean([scan.protocol_pose == "natural" for scan in plan]) < 0.2


def test_left_hands_do_other_poses_than_right_ones():
    plan = plan_session(SimulationOptions(subjects=1))
    right, left = ({scan.name[:7] for scan in plan if scan.side == side} for side in ("right", "left"))
    assert right != left


def test_a_smaller_session_begins_like_a_larger_one():
    small, large = plan_session(SimulationOptions(subjects=2)), plan_session(SimulationOptions(subjects=3))
    assert large[: len(small)] == small


def test_the_same_plan_gives_the_same_numbers(pair):
    planned = PlannedScan("s01_p21_right", 0, "right", protocol_poses()[20].name, "")
    again = simulate_scan(planned, OPTIONS)
    np.testing.assert_array_equal(again.points_mm, pair[0].points_mm)
    np.testing.assert_array_equal(again.faces, pair[0].faces)
    np.testing.assert_array_equal(again.truth.template, pair[0].truth.template)


def test_scans_have_the_size_of_real_ones(pair):
    for scan in pair:
        assert 38_000 < len(scan.points_mm) < 62_000
        assert 200 < np.linalg.norm(np.ptp(scan.points_mm, axis=0)) < 500
        assert scan.faces.max() < len(scan.points_mm)


def test_the_truth_lies_on_the_scan(pair):
    for scan in pair:
        picked = np.ascontiguousarray(scan.truth.template[::40] * 1e3)
        distance = SurfaceTree(scan.points_mm, scan.faces).closest(picked).distances
        # Holes leave some of the truth far from any point.
        assert np.median(distance) < 0.3
        assert (distance < 1.0).mean() > 0.7


def test_a_left_hand_is_a_left_hand(pair):
    """Index, little and palm stand in the mirrored order."""
    signs = []
    for scan in pair:
        wrist, index, middle, little = scan.truth.joints[[0, 1, 4, 7]]
        template = scan.truth.template
        bend = np.cross(index - wrist, little - wrist) @ (template.mean(0) - (wrist + middle) / 2)
        signs.append(np.sign(bend))
    assert signs[0] == -signs[1]


def test_the_reached_angles_are_told(pair):
    for scan in pair:
        assert 0.3 < scan.truth.pose_share <= 1
        assert scan.truth.smallest_det > 0
        assert abs(scan.truth.volume_ratio - 1) < 0.02
        assert scan.truth.deepest < 1e-3


@pytest.mark.parametrize("name", ["p07-knuckles-only", "p23-medium-wrap", "p06-hook"])
def test_flesh_bulges_and_creases(hand, name):
    """Linear skinning of the same hand is off by a millimetre in the mean and by many at its worst."""
    pose = next(pose for pose in protocol_poses() if pose.name == name)
    posed = hand.posed(pose.angles)
    assert posed.pose_share == 1.0
    own = hand.rest_surface[:, 0] < -0.02
    apart = np.linalg.norm(posed.surface - hand.skinned(pose.angles), axis=1)[own]
    assert apart.mean() > 0.8e-3
    assert apart.max() > 4e-3
    assert posed.flesh.smallest_det > 0
    assert abs(posed.flesh.volume_ratio - 1) < 0.02


def test_the_rest_pose_is_at_rest(hand):
    simulator = load_simulator()
    posed = hand.posed(simulator.rest_angles)
    np.testing.assert_allclose(posed.surface, hand.rest_surface, atol=2e-5)


def test_skin_is_smooth_between_the_tetrahedra(hand):
    """No facets: the dihedral angles of the posed fine skin stay near those at rest."""
    pose = next(pose for pose in protocol_poses() if pose.name == "p02-relaxed")
    simulator = load_simulator()
    fine = loop_step(simulator.surface_faces, len(simulator.surface_vertices))
    bent = trimesh.Trimesh(fine(hand.posed(pose.angles).surface), fine.faces, process=False)
    rest = trimesh.Trimesh(fine(hand.rest_surface), fine.faces, process=False)
    assert np.percentile(bent.face_adjacency_angles, 95) < 1.3 * np.percentile(rest.face_adjacency_angles, 95)
