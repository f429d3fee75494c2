"""Fingers that were found late are followed back to where they were lost, and no farther."""

import dataclasses

import numpy as np
import pytest

from corporeal.fitting import finger_search
from corporeal.fitting import fingers_back as fingers_back_module
from corporeal.fitting.files import FrameRecord, frame_path, write_frame
from corporeal.fitting.fingers_back import TrackedSequence, fingers_back
from corporeal.fitting.found_fingers import FINGERS, found_fingers
from corporeal.fitting.frame_fit import FrameFitter
from corporeal.fitting.gaps import SeenPose
from corporeal.fitting.options import TrackingOptions
from corporeal.fitting.track import TrackedFrame, TrackState
from corporeal.geometry.normals import vertex_normals
from corporeal.model.files import open_model
from corporeal.model.jacobian import evaluate
from corporeal.scans.scan import Scan, Unit

OPTIONS = TrackingOptions(samples=16_000)
SEEN = {f"{side}_{part}_seen": 0.8 for side in ("left", "right") for part in ("hand", "forearm")}
# A fist, then a straight hand; it is tracked as a fist for two frames too long.
FISTS, FOUND, FRAMES = 1, 3, 5


@pytest.fixture(scope="module")
def body():
    model = open_model("body")
    return model.replace(
        shape_directions=model.shape_directions[:, :, :0],
        expression_directions=model.expression_directions[:, :, :0],
    )


@pytest.fixture(scope="module")
def fist(body):
    straight = np.zeros((body.joint_count, 3))
    recorded = body.block("right_hand").mixture.means
    pose = straight.copy()
    pose[list(body.block("right_hand").joints)] = recorded[np.abs(recorded).sum(axis=1).argmax()].reshape(
        -1, 3
    )
    return pose


@pytest.fixture(scope="module")
def sequence(body, fist):
    scans = [_scan(body, fist if number < FISTS else np.zeros_like(fist)) for number in range(FRAMES)]
    frames = [
        SeenPose(fist if number < FOUND else np.zeros_like(fist), SEEN, True) for number in range(FRAMES)
    ]
    return TrackedSequence(frames, np.zeros((FRAMES, 3)), lambda number: scans[number])


def _scan(body, pose):
    vertices = evaluate(body, np.zeros(0), pose, np.zeros(3)).vertices
    normals = vertex_normals(vertices, body.faces)
    return Scan("body", vertices, body.faces.astype(np.int64), normals, None, Unit("m", 1.0))


@pytest.mark.slow
def test_found_fingers_are_followed_back_to_where_the_scan_has_others(body, fist, sequence):
    fitter, looked = FrameFitter(body, OPTIONS), []
    found = fingers_back(fitter, sequence, looked.append)
    assert sorted(found) == list(range(FISTS, FOUND))
    assert looked == list(range(FOUND - 1, FISTS - 2, -1))
    joints = list(body.block("right_hand").joints)
    others = np.setdiff1d(np.arange(body.joint_count), joints)
    for pose in found.values():
        assert np.rad2deg(np.linalg.norm(pose[joints], axis=1)).max() < 10
        np.testing.assert_array_equal(pose[others], fist[others])


@pytest.mark.slow
@pytest.mark.parametrize("enough", [True, False], ids=["seen", "too little seen to tell in one frame"])
def test_fingers_found_wrongly_give_way_to_those_before(body, fist, sequence, monkeypatch, enough):
    """All scans show fists; the last frames were tracked as straight hands."""
    if not enough:
        monkeypatch.setattr(finger_search, "_FEWEST", 1.0)
    scan = _scan(body, fist)
    fitter = FrameFitter(body, OPTIONS)
    found = fingers_back(fitter, dataclasses.replace(sequence, scan_of=lambda number: scan))
    assert sorted(found) == list(range(FOUND, FRAMES))
    joints = list(body.block("right_hand").joints)
    for pose in found.values():
        assert np.rad2deg(np.linalg.norm(pose[joints] - fist[joints], axis=1)).max() < 10


def test_fingers_that_leap_nowhere_are_not_looked_at(body, fist, sequence):
    fitter, looked = FrameFitter(body, OPTIONS), []
    still = dataclasses.replace(sequence, frames=[SeenPose(fist, SEEN, True)] * FRAMES)
    assert (
        fingers_back(fitter, still, looked.append)
        == {}
        == fingers_back(fitter, dataclasses.replace(sequence, frames=[], translations=np.zeros((0, 3))))
    )
    blind = FrameFitter(body, dataclasses.replace(OPTIONS, find_fingers=False))
    assert fingers_back(blind, sequence, looked.append) == {}
    assert looked == []


def test_a_frame_that_failed_and_one_without_a_scan_end_it(body, sequence):
    fitter, looked = FrameFitter(body, OPTIONS), []
    lost = list(sequence.frames)
    lost[FOUND - 1] = dataclasses.replace(lost[FOUND - 1], tracked=False)
    assert fingers_back(fitter, dataclasses.replace(sequence, frames=lost), looked.append) == {}
    assert looked == []
    assert fingers_back(fitter, dataclasses.replace(sequence, scan_of=lambda number: None)) == {}


def test_out_of_sight_they_go_on_unchanged(body, fist, sequence):
    """No scan is read there: what is hardly seen says nothing."""
    hidden = [
        SeenPose(frame.pose, SEEN | {"right_hand_seen": 0.1 if number < FOUND else 0.8}, True)
        for number, frame in enumerate(sequence.frames)
    ]
    unread = dataclasses.replace(sequence, frames=hidden, scan_of=lambda number: pytest.fail("was read"))
    found = fingers_back(FrameFitter(body, OPTIONS), unread)
    assert sorted(found) == list(range(FOUND))
    for pose in found.values():
        np.testing.assert_array_equal(pose, np.zeros_like(fist))


@pytest.mark.slow
@pytest.mark.parametrize("wrong", [True, False], ids=["tracked wrongly before", "another pose before"])
def test_a_hand_that_is_back_tells_how_it_was_before(body, fist, sequence, monkeypatch, wrong):
    """A fist until it was out of sight, tracked as a straight hand once it has settled; no finger leaps."""
    monkeypatch.setattr(fingers_back_module, "_LEAP", np.inf)
    monkeypatch.setattr(fingers_back_module, "SETTLING", 1)
    frames = list(sequence.frames)
    frames[FOUND - 1] = SeenPose(fist, SEEN | {"right_hand_seen": 0.0}, True)
    frames[FOUND] = SeenPose(fist, SEEN, True) if wrong else frames[FOUND]
    before, after = (_scan(body, pose) for pose in (np.zeros_like(fist) if wrong else fist, 0 * fist))
    given = dataclasses.replace(
        sequence, frames=frames, scan_of=lambda number: before if number < FOUND else after
    )
    found = fingers_back(FrameFitter(body, OPTIONS), given)
    assert sorted(found) == (list(range(FOUND)) if wrong else [])
    joints = list(body.block("right_hand").joints)
    for pose in found.values():
        assert np.rad2deg(np.linalg.norm(pose[joints], axis=1)).max() < 10


@pytest.mark.slow
def test_what_was_found_is_kept_beside_the_records(body, fist, sequence, tmp_path):
    names = [f"{number:04d}" for number in range(FRAMES)]
    still = np.zeros_like(fist)
    for name, frame in zip(names, sequence.frames, strict=True):
        state = TrackState(frame.pose, np.zeros(3), True, still, np.zeros(3), np.zeros(2, dtype=np.int64))
        tracked = TrackedFrame(name, "ok", "", frame.pose, np.zeros(3), None, {}, dict(SEEN))
        write_frame(frame_path(tmp_path, name), FrameRecord(tracked, state, name))
    fitter, looked = FrameFitter(body, OPTIONS), []

    def again():
        return found_fingers(tmp_path, names, fitter, lambda name: sequence.scan_of(int(name)), looked.append)

    first, read = again(), list(looked)
    assert read and sorted(first) == names[FISTS:FOUND]
    assert {name: pose.tolist() for name, pose in again().items()} == {
        name: pose.tolist() for name, pose in first.items()
    }
    assert looked == read
    content = (tmp_path / FINGERS).read_bytes()
    (tmp_path / FINGERS).write_bytes(content[:100])
    again()
    assert looked == read * 2 and (tmp_path / FINGERS).read_bytes() == content
    # Another scan behind a record: all is looked at anew.
    record = frame_path(tmp_path, names[0])
    other = FrameRecord(
        TrackedFrame(names[0], "ok", "", still, np.zeros(3), None, {}, dict(SEEN)),
        TrackState(fist, np.zeros(3), True, still, np.zeros(3), np.zeros(2, dtype=np.int64)), "another",
    )  # fmt: skip
    write_frame(record, other)
    again()
    assert looked == read * 3
