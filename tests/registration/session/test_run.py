"""The manifest's guard, new starts, a full disk and the second round, in this process."""

import errno
import json
from dataclasses import replace

import numpy as np
import pytest

from corporeal.registration.gaussian_pose import GaussianPose
from corporeal.registration.session import files
from corporeal.registration.session.files import SessionFolderError, read_priors, read_records
from corporeal.registration.session.records import FoundLandmarks, KnownLandmarks
from corporeal.registration.session.run import SessionPlan, Watcher, register_session
from corporeal.scans.formats.session import read_session


class Listener(Watcher):
    def __init__(self):
        self.notes, self.done = [], []

    def note(self, sentence):
        self.notes.append(sentence)

    def advance(self, row):
        self.done.append(row["name"])


def _inline(setup, jobs):
    worker = setup.start()
    for job in jobs:
        yield job, worker(job)


@pytest.fixture
def plan(cheap, make_session, tmp_path):
    description = {"model": {"name": "m", "sha256": "0"}, "options": {"surface": [{"points": 1500}]}}
    session = read_session(make_session(), (".txt",))
    return SessionPlan(
        session, tmp_path / "reg", cheap.CheapSetup(), description, _inline, watcher=Listener()
    )


def _timeless(items):
    return [item | {"seconds": {}} for item in items]


def _again(plan, **changes):
    return replace(plan, watcher=Listener(), **changes)


def test_items_know_subject_pose_and_side(plan):
    items = register_session(plan)
    assert [item["name"] for item in items] == [f"s{number:02}" for number in range(24)]
    assert items[7] | {"seconds": {}} == items[7] | {
        "subject": "u1", "protocol_pose": "p1", "side": "right", "round": 1, "seconds": {},
    }  # fmt: skip
    assert json.loads((plan.folder / "session.json").read_text())["items"] == items
    second = _again(plan)
    assert register_session(second) == items and not second.watcher.done


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"options": {"surface": [{"points": 1400}]}}, r"option surface\.0\.points: 1500 -> 1400"),
        ({"model": {"name": "m", "sha256": "1"}}, "the model: sha256: 0 -> 1"),
    ],
)
def test_a_change_is_named_and_a_restart_redoes_all(plan, changes, words):
    register_session(plan)
    (plan.folder / "decisions.jsonl").write_text('{"name": "s01", "decision": "reject", "time": 0}\n')
    changed = _again(plan, description=plan.description | changes)
    with pytest.raises(SessionFolderError, match=words):
        register_session(changed)
    assert not changed.watcher.done and len(read_records(plan.folder)) == 24
    again = replace(changed, restart=True)
    register_session(again)
    assert len(again.watcher.done) == 24
    assert (plan.folder / "decisions-1.jsonl").exists() and not files.read_decisions(plan.folder)


def test_a_changed_list_is_named_and_added_scans_are_registered(plan):
    scans = plan.session.scans
    first = _again(plan, session=replace(plan.session, scans=scans[:20]))
    register_session(first)
    added = _again(plan)
    register_session(added)
    assert added.watcher.done == [scan.name for scan in scans[20:]]
    with pytest.raises(SessionFolderError, match="s20 is no longer in the session"):
        register_session(first)
    swapped = (replace(scans[0], side="right"), *scans[1:])
    with pytest.raises(SessionFolderError, match=r"s00\.side: left -> right"):
        register_session(_again(plan, session=replace(plan.session, scans=swapped)))


def test_changed_content_is_registered_again_and_a_copied_file_is_not(plan):
    register_session(plan)
    folder = plan.session.folder
    (folder / "s02.txt").write_text("another")
    (folder / "s03.txt").write_text((folder / "s03.txt").read_text())
    again = _again(plan)
    register_session(again)
    assert again.watcher.done == ["s02"]


def test_records_without_a_manifest_are_not_touched(plan):
    register_session(plan)
    (plan.folder / "manifest.json").unlink()
    with pytest.raises(SessionFolderError, match="holds records but no"):
        register_session(_again(plan))
    assert len(read_records(plan.folder)) == 24


def test_known_landmarks_reach_the_job_of_their_scan(plan, cheap):
    found = FoundLandmarks("set", ("tip",), np.ones((1, 3)), np.ones(1), 0.9)
    known = {"s03": KnownLandmarks(found, "0" * 64, "an earlier registration")}
    seen = {}

    class Looking(cheap.CheapWorker):
        def __call__(self, job):
            seen[job.name, job.round_number] = job.landmarks
            return replace(super().__call__(job), landmarks=found)

    class LookingSetup:
        def start(self):
            return Looking(0.0)

    register_session(_again(plan, setup=LookingSetup(), rounds=2, landmarks=known))
    assert {name for name, landmarks in seen.items() if landmarks is not None and name[1] == 1} == {
        ("s03", 1)
    }
    assert seen["s03", 1] is known["s03"]
    second = seen["s04", 2]
    assert second.origin == "the first round" and second.sha256 == files.sha256_of(
        plan.session.folder / "s04.txt"
    )
    np.testing.assert_array_equal(second.found.positions, found.positions)


def test_a_full_disk_stops_the_session_and_leaves_no_half_record(plan, monkeypatch):
    real, left = files.write_bytes, [6]

    def full(path, content):
        left[0] -= 1
        if left[0] < 0:
            raise OSError(errno.ENOSPC, "No space left on device", str(path))
        real(path, content)

    monkeypatch.setattr(files, "write_bytes", full)
    with pytest.raises(SessionFolderError, match=r"No space left on device.*goes on where it stopped"):
        register_session(plan)
    assert len(read_records(plan.folder)) == 5
    monkeypatch.setattr(files, "write_bytes", real)
    again = _again(plan)
    register_session(again)
    assert len(again.watcher.done) == 19


def test_the_second_round_learns_from_accepted_poses_of_both_sides(plan):
    register_session(plan)
    first = {record.name: record for record in read_records(plan.folder)}
    lines = [{"name": "s00", "decision": "reject", "time": 0}]
    (plan.folder / "decisions.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    second = _again(plan, rounds=2)
    items = register_session(second)
    priors = read_priors(plan.folder)
    assert set(priors) == {"p0", "p1", "p2"} and all(prior.side == "right" for prior in priors.values())
    accepted = [
        record.pose[1:] * ([1, -1, -1] if record.side == "left" else [1, 1, 1])
        for name, record in sorted(first.items())
        if record.row["protocol_pose"] == "p0" and record.row["status"] == "ok" and name != "s00"
    ]
    np.testing.assert_allclose(priors["p0"].mean.reshape(-1, 3), np.mean(accepted, axis=0), atol=1e-12)
    assert len(np.linalg.cholesky(priors["p0"].covariance + 1e-12 * np.eye(45)))
    assert {item["round"] for item in items} == {2}
    # A prior that was learned once is not learned again from its own results.
    (plan.folder / "records" / "s05.npz").unlink()
    third = _again(plan, rounds=2)
    assert _timeless(register_session(third)) == _timeless(items)
    assert third.watcher.done == ["s05", "s05"]
    with pytest.raises(SessionFolderError, match="in its second round already"):
        register_session(_again(plan, rounds=1))


def test_a_second_round_that_ends_worse_keeps_the_first(plan, cheap):
    register_session(plan)

    class Worse(cheap.CheapWorker):
        def __call__(self, job):
            record = super().__call__(job)
            return replace(record, row=record.row | {"status": "failed", "reason": "ran away"})

    class WorseSetup:
        def start(self):
            return Worse(0.0)

    first = {record.name: record for record in read_records(plan.folder)}
    register_session(_again(plan, rounds=2, setup=WorseSetup()))
    for record in read_records(plan.folder):
        assert record.row["status"] == first[record.name].row["status"] and record.row["round"] == 2
        assert "ran away" in record.row["notes"][-1]
        np.testing.assert_array_equal(record.vertices, first[record.name].vertices)


def test_a_gaussian_of_the_other_hand_is_its_mirror_image(rng):
    factor = rng.standard_normal((45, 45))
    right = GaussianPose(rng.standard_normal(45), factor @ factor.T, "right")
    left = right.for_side("left")
    poses = rng.multivariate_normal(right.mean, right.covariance, 5).reshape(5, 15, 3)
    mirrored = (poses * [1, -1, -1]).reshape(5, 45)
    for pose, other in zip(poses.reshape(5, 45), mirrored, strict=True):
        ours, theirs = pose - right.mean, other - left.mean
        distances = [
            d @ np.linalg.solve(c, d) for d, c in ((ours, right.covariance), (theirs, left.covariance))
        ]
        assert distances[0] == pytest.approx(distances[1], rel=1e-9)
    np.testing.assert_array_equal(left.for_side("right").covariance, right.covariance)
