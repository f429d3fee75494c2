"""What every term of the registration is worth, on a part of a simulated session.

    python benchmarks/registration_ablation.py SESSION REG [--scans 200] [--workers 2] [--only NAME ...]

REG holds the session's registrations (``corporeal register SESSION -o REG``): the landmarks found there and
the priors of its accepted poses are used here, so that the variants differ in nothing but the term left out.
Scans are taken evenly from all protocol poses, without those spoilt on purpose. Distances in millimetres.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from corporeal.model.files import open_model
from corporeal.registration.gaussian_pose import mirrored_pose, pose_priors
from corporeal.registration.ground_truth import TRUE_FAILURE_MM, errors_against_truth
from corporeal.registration.options import RegistrationOptions
from corporeal.registration.session.files import read_records
from corporeal.registration.session.jobs import ScanJob
from corporeal.registration.session.pool import run_local
from corporeal.registration.session.records import SessionRecord
from corporeal.registration.session.tasks import RegistrationSetup
from corporeal.scans.files import SCAN_SUFFIXES
from corporeal.scans.formats.session import SessionScan, read_session

# So wide that it is no kernel, so loose that it is no term.
_NO_KERNEL, _LOOSE = 1.0, 1e3


def variants() -> dict[str, RegistrationOptions]:
    """Name -> options with one term left out."""
    usual = RegistrationOptions.for_sessions()

    def changed(**numbers: float) -> RegistrationOptions:
        stages = {
            name: tuple(
                dataclasses.replace(stage, **{k: v for k, v in numbers.items() if hasattr(stage, k)})
                for stage in getattr(usual, name)
            )
            for name in ("surface", "free")
        }
        return dataclasses.replace(usual, **stages)

    no_prior = changed(pose_prior_scale=_LOOSE)
    no_prior = dataclasses.replace(
        no_prior, landmarks=dataclasses.replace(no_prior.landmarks, pose_prior_scale=_LOOSE)
    )
    return {
        "all terms": usual,
        "without free vertices": dataclasses.replace(usual, free=()),
        "without coupling": changed(coupling_sigma=_LOOSE),
        "without robust function": changed(robust_scale=_NO_KERNEL),
        "without pose prior": no_prior,
        "without finger separation": changed(separation_sigma=np.inf),
        "without second starts": dataclasses.replace(usual, second_starts=0),
    }


def chosen_scans(folder: Path, count: int, seed: int) -> list[SessionScan]:
    """Scans drawn evenly from all protocol poses; none that was spoilt on purpose."""
    by_pose: dict[str, list[SessionScan]] = {}
    for scan in read_session(folder, SCAN_SUFFIXES).scans:
        with np.load(folder / "truth" / f"{scan.name}.npz") as truth:
            if not str(truth["fault"]):
                by_pose.setdefault(scan.protocol_pose or "", []).append(scan)
    generator = np.random.default_rng(seed)
    shuffled = [list(generator.permutation(np.array(scans, dtype=object))) for scans in by_pose.values()]
    return [scan for scan in _in_turns(shuffled)][:count]


def _in_turns(lists: list[list[SessionScan]]) -> Iterator[SessionScan]:
    for place in range(max(map(len, lists))):
        for scans in lists:
            if place < len(scans):
                yield scans[place]


def accepted_poses(records: list[SessionRecord]) -> dict[str, list[np.ndarray]]:
    """Protocol pose -> poses that ended ok, as right hands."""
    poses: dict[str, list[np.ndarray]] = {}
    for record in records:
        if record.pose is not None and record.row["status"] == "ok":
            right = mirrored_pose(record.pose) if record.side == "left" else record.pose
            poses.setdefault(record.row["protocol_pose"], []).append(np.asarray(right, dtype=np.float64))
    return poses


def measured(session: Path, record: SessionRecord, faces: np.ndarray) -> dict[str, float | str]:
    """s2m, v2v and status of one record."""
    if record.vertices is None:
        return {"s2m": np.nan, "v2v": np.nan, "status": "failed"}
    with np.load(session / "truth" / f"{record.name}.npz") as truth:
        errors = errors_against_truth(record.vertices, truth["template"].astype(np.float64), faces)
    return {
        "s2m": record.row["s2m_mm"]["mean"],
        "v2v": errors.v2v,
        "normal": errors.normal,
        "tangential": errors.tangential,
        "status": record.row["status"],
    }


def summary(rows: list[dict]) -> dict[str, float]:
    """Means over all scans, and the share that truly failed."""
    v2v = np.array([row["v2v"] for row in rows])
    good = v2v <= TRUE_FAILURE_MM
    mean = {
        key: float(np.nanmean(np.array([row.get(key, np.nan) for row in rows])[good]))
        for key in ("s2m", "v2v", "normal", "tangential")
    }
    return mean | {"v2v of all": float(np.nanmean(v2v)), "truly failed": float(1 - good.mean())}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("session", type=Path)
    parser.add_argument("registrations", type=Path)
    parser.add_argument("--scans", type=int, default=200)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--model", default="start_hand", help="the one that REG was registered with")
    parser.add_argument("--json", type=Path)
    every = [*variants().items(), ("two rounds", RegistrationOptions.for_sessions())]
    parser.add_argument("--only", nargs="+", metavar="NAME", choices=[name for name, _ in every])
    options = parser.parse_args()
    model = open_model(options.model)
    scans = chosen_scans(options.session, options.scans, options.seed)
    known = {record.name: record for record in read_records(options.registrations)}
    priors = pose_priors(accepted_poses(list(known.values())), "right")
    results: dict[str, dict[str, float]] = {}
    print(f"{len(scans)} scans; means over those under {TRUE_FAILURE_MM:g} mm, mm")
    print(f"{'':28}{'s2m':>8}{'v2v':>8}{'normal':>8}{'tangent':>8}{'v2v all':>9}{'failed':>8}")
    for name, chosen in [(name, chosen) for name, chosen in every if name in (options.only or [name])]:
        second = name == "two rounds"
        jobs = [
            ScanJob(
                scan.name,
                str(options.session / scan.file),
                scan.subject,
                scan.protocol_pose,
                scan.side,
                round_number=2 if second else 1,
                prior=priors.get(scan.protocol_pose or "") if second else None,
                landmarks=known[scan.name].known_landmarks("REG") if scan.name in known else None,
            )
            for scan in scans
        ]
        setup = RegistrationSetup(model, chosen, unit="mm")
        rows = [
            measured(options.session, record, model.faces)
            for _, record in run_local(setup, jobs, options.workers)
        ]
        results[name] = summary(rows)
        r = results[name]
        print(
            f"{name:28}{r['s2m']:8.3f}{r['v2v']:8.2f}{r['normal']:8.2f}{r['tangential']:8.2f}"
            f"{r['v2v of all']:9.2f}{r['truly failed']:8.1%}",
            flush=True,
        )
    if options.json is not None:
        options.json.write_text(json.dumps(results, indent=2) + "\n")


if __name__ == "__main__":
    main()
