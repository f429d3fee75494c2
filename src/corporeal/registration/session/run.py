"""A session from its first scan to its list of items; it can be stopped at any moment and goes on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from corporeal.registration.gaussian_pose import GaussianPose, mirrored_pose, pose_priors
from corporeal.registration.session import files
from corporeal.registration.session.files import SessionFolderError
from corporeal.registration.session.jobs import Execute, ScanJob, WorkerSetup
from corporeal.registration.session.lock import folder_lock
from corporeal.registration.session.manifest import check_same, new_manifest
from corporeal.registration.session.records import KnownLandmarks, RecordError, SessionRecord
from corporeal.scans.formats.session import CaptureSession, SessionScan

_RANKS = {"ok": 0, "doubtful": 1, "failed": 2}


class Watcher:
    """Is told how a session goes; the methods here do nothing."""

    def note(self, sentence: str) -> None:
        """Something that the user should know."""

    def begin(self, round_number: int, total: int, done: list[str]) -> None:
        """A round begins; ``done`` holds the statuses of the scans that are done already."""

    def advance(self, row: Mapping[str, Any]) -> None:
        """A record was written."""


@dataclass(frozen=True, eq=False)
class SessionPlan:
    """What to register, how, and where to.

    Attributes:
        session: the scans.
        folder: of the results.
        setup: of the workers.
        description: "model" (name, sha256) and "options" for the manifest.
        execute: runs jobs: the local pool or dask.
        rounds: 1, or 2 for a second one with the pose priors of the first.
        restart: throw away what the folder holds.
        watcher: is told how it goes.
        landmarks: scan name -> what the detector found in it before; it looks at the others.
    """

    session: CaptureSession
    folder: Path
    setup: WorkerSetup
    description: Mapping[str, Any]
    execute: Execute
    rounds: int = 1
    restart: bool = False
    watcher: Watcher = field(default_factory=Watcher)
    landmarks: Mapping[str, KnownLandmarks] = field(default_factory=dict)


def register_session(plan: SessionPlan) -> list[dict[str, Any]]:
    """Register what is not registered yet.

    The parent alone writes to the folder, every record whole or not at all; whoever stops it loses the scans
    that were being worked on.

    Returns:
        The items of all scans, sorted by name; they stand in ``session.json`` too.

    Raises:
        SessionFolderError: the folder holds results of other options, cannot be written, is full, or another
            run writes to it.
        WorkerError: no worker can do its work.
    """
    try:
        with folder_lock(plan.folder):
            items = _registered(plan)
    except OSError as error:
        where = error.filename or plan.folder
        raise SessionFolderError(
            f"{where}: cannot be written ({error.strerror or error}); make room or give another folder, and "
            "the same command goes on where it stopped"
        ) from error
    return items


def _registered(plan: SessionPlan) -> list[dict[str, Any]]:
    records = _prepared(plan)
    missing = [scan for scan in plan.session.scans if scan.name not in records]
    _run_round(plan, records, [_job(plan, scan) for scan in missing], 1)
    if plan.rounds > 1:
        priors = _priors(plan, records)
        jobs = [
            _second_job(plan, scan, priors[scan.protocol_pose], records[scan.name])
            for scan in plan.session.scans
            if scan.protocol_pose in priors and records[scan.name].row["round"] < 2
        ]
        _run_round(plan, records, jobs, 2)
    items = [files.read_record(files.record_path(plan.folder, name)).row for name in sorted(records)]
    files.write_json_file(plan.folder / files.ITEMS, {"items": items})
    return items


def _prepared(plan: SessionPlan) -> dict[str, SessionRecord]:
    """Check and write the manifest; returns the records that still hold."""
    folder, watcher = plan.folder, plan.watcher
    files.make_folder(folder)
    if plan.restart:
        for sentence in files.remove_results(folder):
            watcher.note(sentence)
    manifest = new_manifest(plan.session, plan.description)
    # Size and time tell a changed scan, as for make: hashing two thousand scans would read six gigabytes at
    # every start. Where they differ, as in a copied session, the hash of the content in the record decides.
    paths = {scan.name: plan.session.folder / scan.file for scan in plan.session.scans}
    manifest["stamps"] = files.file_stamps(paths)
    old = files.read_json_file(folder / files.MANIFEST)
    if old is None:
        if files.has_records(folder):
            raise SessionFolderError(
                f"{folder}: holds records but no {files.MANIFEST}, so that it is not known what they were "
                "made from; choose another folder, or redo all with --restart"
            )
        records = {}
    else:
        for sentence in check_same(old, manifest):
            watcher.note(sentence)
        manifest["round"] = old["round"]
        records = _valid_records(plan, paths, old.get("stamps", {}), manifest["stamps"])
    if manifest["round"] > plan.rounds:
        raise SessionFolderError(
            f"{folder}: is in its second round already; use --rounds 2, or redo all with --restart"
        )
    files.remove_leftovers(folder)
    files.write_json_file(folder / files.MANIFEST, manifest)
    return records


def _valid_records(
    plan: SessionPlan, paths: Mapping[str, Path], before: Mapping[str, Any], now: Mapping[str, Any]
) -> dict[str, SessionRecord]:
    """Records that can be read and whose scan has not changed; the others are removed."""
    records = {}
    for name, path in paths.items():
        where = files.record_path(plan.folder, name)
        try:
            record = files.read_record(where)
        except files.RecordMissingError:
            continue
        except RecordError:
            plan.watcher.note(f"{where.name}: was damaged; its scan is registered again")
            files.remove_record(where)
            continue
        known = record.row["sha256"]
        # A scan that is gone keeps its result; one that came back is registered.
        changed = now[name] is not None and (
            known is None or (now[name] != before.get(name) and files.sha256_of(path) != known)
        )
        if changed:
            plan.watcher.note(f"{path.name}: has changed since it was registered; it is registered again")
            files.remove_record(where)
            continue
        records[name] = record
    return records


def _run_round(
    plan: SessionPlan, records: dict[str, SessionRecord], jobs: list[ScanJob], round_number: int
) -> None:
    waiting = {job.name for job in jobs}
    done = [record.row["status"] for name, record in records.items() if name not in waiting]
    plan.watcher.begin(round_number, len(plan.session.scans), done)
    for job, record in plan.execute(plan.setup, jobs):
        kept = record if job.round_number == 1 else _better(records[job.name], record)
        files.write_record(files.record_path(plan.folder, job.name), kept)
        records[job.name] = kept
        plan.watcher.advance(kept.row)


def _better(first: SessionRecord, second: SessionRecord) -> SessionRecord:
    """The second round's record, unless its status is worse."""
    if _RANKS[second.row["status"]] <= _RANKS[first.row["status"]]:
        return second
    sentence = (
        f"the second round ended {second.row['status']} ({second.row['reason']}); the first one is kept"
    )
    row = first.row | {"round": 2, "notes": [*first.row["notes"], sentence]}
    return replace(first, row=row)


def _priors(plan: SessionPlan, records: Mapping[str, SessionRecord]) -> dict[str, GaussianPose]:
    """The pose priors of the second round, learned once and kept."""
    priors = files.read_priors(plan.folder)
    if priors is None:
        decisions = files.read_decisions(plan.folder)
        poses: dict[str, list[Any]] = {}
        sided = False
        for name in sorted(records):
            record = files.read_record(files.record_path(plan.folder, name))
            pose, protocol_pose = record.pose, record.row["protocol_pose"]
            decision = decisions.get(name, "accept" if record.row["status"] == "ok" else "reject")
            if pose is None or protocol_pose is None or decision != "accept":
                continue
            sided = sided or record.side is not None
            poses.setdefault(protocol_pose, []).append(mirrored_pose(pose) if record.side == "left" else pose)
        priors = pose_priors(poses, "right" if sided else None)
        files.write_priors(plan.folder, priors)
    manifest = files.read_json_file(plan.folder / files.MANIFEST) or {}
    files.write_json_file(plan.folder / files.MANIFEST, manifest | {"round": 2})
    without = {scan.protocol_pose for scan in plan.session.scans} - set(priors)
    if without:
        plan.watcher.note(
            f"too few accepted registrations for a prior of {len(without)} poses: first round kept"
        )
    return priors


def _job(plan: SessionPlan, scan: SessionScan) -> ScanJob:
    path = str(plan.session.folder / scan.file)
    known = plan.landmarks.get(scan.name)
    return ScanJob(scan.name, path, scan.subject, scan.protocol_pose, scan.side, landmarks=known)


def _second_job(plan: SessionPlan, scan: SessionScan, prior: GaussianPose, first: SessionRecord) -> ScanJob:
    known = first.known_landmarks("the first round")
    return replace(_job(plan, scan), round_number=2, prior=prior, landmarks=known)
