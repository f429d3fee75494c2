"""Arms out of sight: bridged between where they were seen, all else as it was, as often as it is asked."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from corporeal.fitting.bridged_records import bridge_records
from corporeal.fitting.files import FrameRecord, frame_path, read_frame, write_frame
from corporeal.fitting.gaps import SeenPose, bridged
from corporeal.fitting.track import TrackedFrame, TrackState
from corporeal.model.files import open_model

FRAMES, FIRST, AFTER, FPS = 12, 4, 9, 60.0


@pytest.fixture(scope="module")
def body():
    return open_model("body")


def _frames(body, rng, *, forearm=0.0, seen=None):
    """Steadily turning joints; in the gap the left arm stays where it was, as a tracker holds it."""
    rates = 0.01 * rng.standard_normal((body.joint_count, 3))
    steady = np.arange(FRAMES)[:, None, None] * rates
    arm = [body.joint_names.index(f"left_{name}") for name in ("elbow", "wrist")]
    arm += body.block("left_hand").joints
    frames = []
    for number, true in enumerate(steady):
        pose, gap = true.copy(), FIRST <= number < AFTER
        if gap:
            pose[arm] = steady[FIRST - 1][arm]
        shares = dict.fromkeys(("left_hand", "right_hand", "left_forearm", "right_forearm"), 0.8)
        shares |= {"left_hand": 0.0, "left_forearm": forearm} if gap else {}
        frames.append(SeenPose(pose, {f"{part}_seen": share for part, share in shares.items()}, True))
    return frames, steady, arm


def _degrees(found, expected):
    between = Rotation.from_rotvec(found).inv() * Rotation.from_rotvec(expected)
    return np.rad2deg(between.magnitude())


# Of a missing forearm a thigh beside it may confirm a little.
@pytest.mark.parametrize("forearm", [0.0, 0.06])
def test_a_steady_turn_is_restored_and_nothing_else_moves(body, rng, forearm):
    """Fingers to rounding; elbow and wrist are told by a process whose observations are a degree wide."""
    frames, steady, arm = _frames(body, rng, forearm=forearm)
    found = bridged(body, frames, FPS)
    shoulder = body.joint_names.index("left_shoulder")
    others = [joint for joint in range(body.joint_count) if joint not in {*arm, shoulder}]
    for number, (frame, bridge) in enumerate(zip(frames, found, strict=True)):
        gap = FIRST <= number < AFTER
        assert bridge.hands == (("left_hand",) if gap else ())
        np.testing.assert_array_equal(bridge.pose[others], frame.pose[others])
        if not gap:
            np.testing.assert_array_equal(bridge.pose, frame.pose)
        # Axis-angles that grow steadily about a fixed axis are steady turns.
        assert _degrees(bridge.pose[arm[2:]], steady[number][arm[2:]]).max() < 1e-6
        assert _degrees(bridge.pose[arm[:2]], steady[number][arm[:2]]).max() < 1.0
        assert _degrees(bridge.pose[shoulder], frame.pose[shoulder]) < 1.0


def test_a_missing_forearm_swings_with_the_legs(body, rng):
    """Bent most in the middle of the gap, as a step before and after it; the straight way stays stretched."""
    count, first, after = 90, 40, 58
    left, right, elbow = (body.joint_names.index(name) for name in ("left_hip", "right_hip", "left_elbow"))
    swing = np.cos(2 * np.pi * (np.arange(count) - (first + after - 1) / 2) / 36)
    true = np.zeros((count, body.joint_count, 3))
    true[:, left, 0], true[:, right, 0] = 0.5 * swing, -0.5 * swing
    true[:, elbow, 1] = -np.deg2rad(50 + 40 * swing)
    true += np.deg2rad(0.5) * rng.standard_normal(true.shape)
    frames = []
    for number, pose in enumerate(true):
        gap = first <= number < after
        shares = {f"{side}_{part}_seen": 0.8 for side in ("left", "right") for part in ("hand", "forearm")}
        tracked = pose.copy()
        if gap:
            tracked[elbow] = true[first - 1, elbow]
            shares |= {"left_hand_seen": 0.0, "left_forearm_seen": 0.0}
        frames.append(SeenPose(tracked, shares, True))
    found = np.array([bridge.pose[elbow] for bridge in bridged(body, frames, FPS)])[first:after]
    straight = np.linspace(true[first - 1, elbow], true[after, elbow], after - first + 2)[1:-1]
    assert _degrees(straight, true[first:after, elbow]).max() > 30
    assert _degrees(found, true[first:after, elbow]).max() < 5


def test_an_upper_arm_keeps_its_direction_and_gets_a_steady_twist(body, rng):
    frames, _, _ = _frames(body, rng)
    shoulder, elbow = (body.joint_names.index(f"left_{name}") for name in ("shoulder", "elbow"))
    rest = body.joint_regressor @ body.template
    bone = (rest[elbow] - rest[shoulder]) / np.linalg.norm(rest[elbow] - rest[shoulder])
    twist = np.deg2rad(rng.uniform(-40, 40, FRAMES))
    twist[:FIRST] = twist[AFTER:] = 0
    turned = []
    for frame, angle in zip(frames, twist, strict=True):
        pose = frame.pose.copy()
        own = Rotation.from_rotvec([0, 0, -0.8]) * Rotation.from_rotvec(angle * bone)
        pose[shoulder] = own.as_rotvec()
        turned.append(dataclasses.replace(frame, pose=pose))
    for frame, bridge in zip(turned, bridged(body, turned, FPS), strict=True):
        before, after = (Rotation.from_rotvec(pose[shoulder]) for pose in (frame.pose, bridge.pose))
        np.testing.assert_allclose(after.apply(bone), before.apply(bone), atol=1e-9)
        assert _degrees(bridge.pose[shoulder], [0, 0, -0.8]) < 1e-6


def test_an_elbow_that_is_seen_stays(body, rng):
    frames, _, _ = _frames(body, rng, forearm=0.7)
    elbow = body.joint_names.index("left_elbow")
    for frame, bridge in zip(frames, bridged(body, frames, FPS), strict=True):
        np.testing.assert_array_equal(bridge.pose[elbow], frame.pose[elbow])


def test_what_does_not_come_back_and_what_failed_stays(body, rng):
    frames, _, _ = _frames(body, rng)
    for part in (frames[:AFTER], frames[FIRST:]):
        for frame, bridge in zip(part, bridged(body, part, FPS), strict=True):
            np.testing.assert_array_equal(bridge.pose, frame.pose)
            assert bridge.hands == ()
    held = frames[FIRST].pose
    frames[FIRST + 1] = SeenPose(held, {}, False)
    found = bridged(body, frames, FPS)
    np.testing.assert_array_equal(found[FIRST + 1].pose, held)
    assert found[FIRST].hands == found[FIRST + 2].hands == ("left_hand",)
    failed = [SeenPose(frame.pose, {}, False) for frame in frames]
    assert all(bridge.hands == () for bridge in bridged(body, failed, FPS))
    hand = open_model("hand")
    alone = [SeenPose(np.zeros((hand.joint_count, 3)), {"hand_seen": 0.0}, True)]
    assert bridged(hand, alone, FPS)[0].hands == ()


def test_a_finger_found_at_once_has_set_out_before(body):
    finger = body.block("right_hand").joints[4]
    shares = {f"{side}_{part}_seen": 0.8 for side in ("left", "right") for part in ("hand", "forearm")}
    poses = np.zeros((10, body.joint_count, 3))
    poses[6:, finger, 2] = np.deg2rad(40)
    found = bridged(body, [SeenPose(pose, shares, True) for pose in poses], FPS)
    turned = np.rad2deg([bridge.pose[finger, 2] for bridge in found])
    np.testing.assert_allclose(turned, [0, 0, 0, 0, 10, 25, 40, 40, 40, 40], atol=1e-9)
    assert [bridge.led for bridge in found] == [()] * 4 + [("right_hand",)] * 2 + [()] * 4
    for bridge, pose in zip(found, poses, strict=True):
        np.testing.assert_array_equal(np.delete(bridge.pose, finger, axis=0), np.delete(pose, finger, axis=0))


def _recorded(frames, folder):
    """Records of frames as they were tracked; their names."""
    names = [f"{number:04d}" for number in range(len(frames))]
    for name, frame in zip(names, frames, strict=True):
        still = np.zeros_like(frame.pose)
        state = TrackState(frame.pose, np.zeros(3), True, still, np.zeros(3), np.zeros(2, dtype=np.int64))
        tracked = TrackedFrame(name, "ok", "", frame.pose, np.zeros(3), None, {}, dict(frame.signals))
        write_frame(frame_path(folder, name), FrameRecord(tracked, state))
    return names


def test_records_are_bridged_alike_however_often(body, rng, tmp_path):
    frames, _, _ = _frames(body, rng)
    names = _recorded(frames, tmp_path)
    # As far as an interrupted run came: the gap is still open.
    assert bridge_records(tmp_path, names[:AFTER], body, FPS, {}) == []
    changed = []
    said = bridge_records(tmp_path, names, body, FPS, {}, changed.append)
    assert changed == names[FIRST:AFTER]
    assert said == [
        "left hand out of sight from 0004 to 0008: its pose there is laid between those before and after"
    ]
    first = [frame_path(tmp_path, name).read_bytes() for name in names]
    assert bridge_records(tmp_path, names, body, FPS, {}, changed.append) == said
    assert changed == names[FIRST:AFTER]
    assert [frame_path(tmp_path, name).read_bytes() for name in names] == first
    expected = bridged(body, frames, FPS)
    for name, bridge in zip(names, expected, strict=True):
        record = read_frame(frame_path(tmp_path, name))
        np.testing.assert_array_equal(record.frame.pose, bridge.pose)
        assert ("left_hand_bridged" in record.frame.signals) == bool(bridge.hands)
    # The frames behind the gap are gone: what was bridged goes back to what was tracked.
    assert bridge_records(tmp_path, names[:AFTER], body, FPS, {}) == []
    for name, frame in zip(names[:AFTER], frames, strict=False):
        np.testing.assert_array_equal(read_frame(frame_path(tmp_path, name)).frame.pose, frame.pose)


def test_fingers_found_later_are_in_the_records_that_need_them(body, rng, tmp_path):
    frames, _, _ = _frames(body, rng)
    names = _recorded(frames, tmp_path)
    finger = body.block("right_hand").joints[2]
    found = {name: frames[number].pose.copy() for number, name in enumerate(names[:3])}
    for pose in found.values():
        pose[finger] += [0.0, 0.0, 0.1]
    said = bridge_records(tmp_path, names, body, FPS, found)
    assert said[1:] == ["fingers of the right hand in 3 frames are those that were found later"]
    for number, name in enumerate(names):
        frame = read_frame(frame_path(tmp_path, name)).frame
        assert ("right_hand_found" in frame.signals) == (number < 3)
        expected = frames[number].pose[finger] + (number < 3) * np.array([0.0, 0.0, 0.1])
        np.testing.assert_allclose(frame.pose[finger], expected, atol=1e-9)
    bridge_records(tmp_path, names, body, FPS, {})
    assert "right_hand_found" not in read_frame(frame_path(tmp_path, names[0])).frame.signals
