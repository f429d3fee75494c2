"""Simulated people: the base, skinning, motion, webs, and what the scanner makes of a frame."""

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from corporeal.geometry.closest_points import SurfaceTree
from corporeal.geometry.normals import face_vectors
from corporeal.model.files import open_model
from corporeal.scans.simulation.bodies.files import load_body_simulator
from corporeal.scans.simulation.bodies.motion import BodyMotion, body_motion
from corporeal.scans.simulation.bodies.people import body_at_rest, body_subject
from corporeal.scans.simulation.bodies.person import MovingPerson
from corporeal.scans.simulation.bodies.sequences import (
    PARTS,
    SCANNER,
    SequenceOptions,
    SequenceSimulator,
    plan_sequences,
)
from corporeal.scans.simulation.bodies.skinning import dual_quaternion_skinned
from corporeal.scans.simulation.bodies.webs import finger_webs

OPTIONS = SequenceOptions(sequences=8, frames=200, subjects=4, seed=3)


@pytest.fixture(scope="module")
def simulator():
    return load_body_simulator()


@pytest.fixture(scope="module")
def sequence():
    return SequenceSimulator(plan_sequences(OPTIONS)[1])


@pytest.fixture(scope="module")
def whole(sequence):
    """A frame in which nothing is missing."""
    return sequence.frame(2)


def volume(vertices, faces):
    return np.einsum("fa,fa->f", face_vectors(vertices, faces), vertices[faces[:, 0]]).sum() / 6


def test_the_base_is_one_closed_skin_with_shares_for_weights(simulator):
    edges = np.concatenate(
        [simulator.faces[:, [0, 1]], simulator.faces[:, [1, 2]], simulator.faces[:, [2, 0]]]
    )
    assert len(np.unique(edges, axis=0)) == len(edges), "every edge is used once in each direction"
    assert {tuple(edge) for edge in edges} == {tuple(edge) for edge in edges[:, ::-1]}
    assert np.abs(np.asarray(simulator.weights.sum(1)) - 1).max() < 1e-12
    assert simulator.weights.min() >= 0
    assert (simulator.parents[1:] < np.arange(1, len(simulator.parents))).all()
    assert 0.04 < volume(simulator.vertices, simulator.faces) < 0.12, "cubic metres of an adult"


def test_the_template_has_its_place_on_the_skin(simulator):
    body = open_model("body")
    assert simulator.template_placed.shape == (body.vertex_count,)
    assert simulator.template_placed.mean() > 0.9
    assert simulator.template_faces.max() < len(simulator.faces)


def test_people_are_determined_by_number_and_seed_and_are_as_tall_as_adults(simulator):
    heights = []
    for number in range(6):
        subject, again = (body_subject(simulator, number, 3) for _ in range(2))
        assert np.array_equal(subject.identity, again.identity)
        rest, _ = body_at_rest(simulator, subject)
        heights.append(np.ptp(rest[:, 1]))
    assert min(heights) > 1.4 and max(heights) < 2.05
    assert np.ptp(heights) > 0.05


def test_skinning_moves_a_rigid_body_rigidly_and_keeps_the_volume_of_a_twist(simulator, rng):
    count = len(simulator.bones)
    turn = Rotation.random(random_state=1).as_matrix()
    moved = dual_quaternion_skinned(
        simulator.vertices, simulator.weights, simulator.parents, np.tile(turn, (count, 1, 1)),
        np.tile([0.1, -0.2, 0.3], (count, 1)),
    )  # fmt: skip
    assert np.abs(moved - (simulator.vertices @ turn.T + [0.1, -0.2, 0.3])).max() < 1e-12


def test_bones_keep_their_lengths_and_soles_the_ground(simulator, rng):
    clip = simulator.clips[0]
    motion = body_motion(simulator, clip, 24, rng)
    person = MovingPerson(simulator, body_subject(simulator, 1, 0), motion)
    frames = [person.posed(k) for k in range(0, 24, 6)]
    for first, second in ((18, 20), (4, 7), (40, 41), (53, 54)):
        lengths = [np.linalg.norm(f.joints[first] - f.joints[second]) for f in frames]
        assert np.ptp(lengths) < 1e-4, "the forearm is two bones, which share a twist"
    assert all(-0.1 < frame.vertices[:, 1].min() < 0.6 for frame in frames)


def test_bends_keep_their_volume(simulator):
    pose = np.zeros((1, 55, 3))
    still = MovingPerson(simulator, body_subject(simulator, 0, 0), BodyMotion(pose, np.zeros((1, 3))))
    bent = pose.copy()
    bent[0, [4, 5], 0], bent[0, 18, 1], bent[0, 19, 1] = 1.6, -1.6, 1.6
    sitting = MovingPerson(simulator, body_subject(simulator, 0, 0), BodyMotion(bent, np.zeros((1, 3))))
    volumes = [volume(person.posed(0).vertices, simulator.faces) for person in (still, sitting)]
    assert abs(volumes[1] / volumes[0] - 1) < 0.02


def test_a_short_clip_is_played_to_and_fro_without_a_jump(simulator, rng):
    clip = min(simulator.clips, key=lambda clip: len(clip.pose))
    motion = body_motion(simulator, clip, 3 * len(clip.pose), rng)
    steps = [
        (Rotation.from_rotvec(a).inv() * Rotation.from_rotvec(b)).magnitude().max()
        for a, b in zip(motion.pose[:-1], motion.pose[1:], strict=True)
    ]
    assert np.degrees(max(steps)) < 25


def test_no_motion_reaches_over_a_slip_of_its_recording(simulator):
    for seed, clip in enumerate(simulator.clips):
        pose = body_motion(simulator, clip, 190, np.random.default_rng(seed)).pose[:, :22]
        before, after = (Rotation.from_rotvec(part.reshape(-1, 3)) for part in (pose[:-1], pose[1:]))
        assert np.degrees((before.inv() * after).magnitude().max()) < 20.5, clip.name


def test_webs_bridge_what_is_narrow_and_face_away_from_each_other(rng):
    spread, along = 0.02, np.array([0.0, 0.025, 0.045])
    joints = np.zeros((15, 3))
    for row, place in ((0, 0), (3, 1), (9, 2), (6, 3)):
        joints[row : row + 3, 0] = spread * place
        joints[row : row + 3, 1] = along
    webs = finger_webs(joints, 0.006, np.full(3, 200.0))
    assert len(webs) == 6
    assert finger_webs(joints, 0.0, np.full(3, 200.0)) == ()
    for back, palm in zip(webs[::2], webs[1::2], strict=True):
        normals = [face_vectors(sheet.vertices, sheet.faces).sum(0) for sheet in (back, palm)]
        assert normals[0] @ (back.vertices.mean(0) - palm.vertices.mean(0)) > 0
        assert normals[1] @ (back.vertices.mean(0) - palm.vertices.mean(0)) < 0
        assert back.vertices[:, 0].min() > 0 and back.vertices[:, 0].max() < 3 * spread


def test_losses_are_as_long_as_stated_and_never_two_at_a_time():
    plan = plan_sequences(OPTIONS)
    assert plan == plan_sequences(OPTIONS)
    assert len({planned.name for planned in plan}) == 8
    assert len({planned.subject for planned in plan}) == 4
    assert {loss.part for planned in plan for loss in planned.losses} == set(PARTS)
    for planned in plan:
        assert planned.losses
        assert all(5 <= loss.end - loss.begin <= 30 for loss in planned.losses)
        assert all(len(planned.missing(frame)) <= 1 for frame in range(planned.frames))
        assert planned.missing(planned.frames - 1) == ()


def test_a_frame_has_the_size_and_the_noise_of_a_body_scanner(sequence, whole):
    assert len(SCANNER.units) == 22
    points = whole.points_mm / 1e3
    assert 42_000 < len(points) < 58_000
    skin = sequence._person.posed(2)
    distance = SurfaceTree(skin.vertices, sequence._simulator.faces).closest(points).distances
    body = np.linalg.norm(points[:, None] - skin.joints[None, [20, 21]], axis=2).min(1) > 0.3
    assert 0.4e-3 < np.sqrt(np.mean(distance[body] ** 2)) < 1.1e-3, (
        "along the normal: less than along the view"
    )


def test_the_truth_lies_on_the_scan(whole):
    truth = whole.truth
    assert truth.seen.mean() > 0.75
    gaps = cKDTree(whole.points_mm / 1e3).query(truth.template[truth.seen])[0]
    assert np.median(gaps) < 4e-3 and gaps.max() < 0.013
    assert not truth.seen[~truth.placed].any()


def test_what_is_missing_is_not_scanned_and_comes_back(sequence):
    loss = sequence.planned.losses[0]
    side = loss.part.split("_")[0]
    hand = slice(25, 40) if side == "left" else slice(40, 55)
    gaps = []
    for frame in (loss.begin, loss.end):
        made = sequence.frame(frame)
        assert made.truth.missing == ((loss.part,) if frame == loss.begin else ())
        gaps.append(cKDTree(made.points_mm / 1e3).query(made.truth.joints[hand])[0].mean())
    assert gaps[1] < 0.015 < gaps[0]


def test_a_frame_follows_from_the_plan_and_its_number_alone(sequence, whole):
    again = SequenceSimulator(plan_sequences(OPTIONS)[1]).frame(2)
    assert np.array_equal(again.points_mm, whole.points_mm)
    assert np.array_equal(again.faces, whole.faces)
    assert not np.array_equal(sequence.frame(3).points_mm, whole.points_mm)
