"""``corporeal simulate``: a virtual capture session of hands with the truth beside every scan."""

from __future__ import annotations

import dataclasses
import io
import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

import corporeal
from corporeal.atomic import write_bytes
from corporeal.cli import simulate_bodies
from corporeal.cli.commands import Simulate
from corporeal.cli.errors import CommandError
from corporeal.cli.files import check_result, write_json, write_result
from corporeal.cli.simulation_pool import check_same, make_pieces
from corporeal.export.meshes import write_ply
from corporeal.scans.simulation.faults import spoiled_bytes
from corporeal.scans.simulation.simulate import (
    NATURAL_SHARE,
    PlannedScan,
    ScanTruth,
    SimulationOptions,
    plan_session,
    simulate_scan,
    subjects_of,
)

_FORMAT = "corporeal-session-1"


def run(config: Simulate) -> int:
    """Make what is missing of a session, or of sequences of bodies."""
    if config.body:
        return simulate_bodies.run(config)
    options = SimulationOptions(
        SimulationOptions.subjects if config.subjects is None else config.subjects,
        config.poses,
        config.seed,
        config.sides,
        config.objects,
        config.bad_one_in,
        config.natural_share,
    )
    _check_call(config)
    plan = plan_session(options)
    _write_session(config.output, options, plan)
    missing = [scan for scan in plan if not _truth_file(config.output, scan).exists()]
    console = Console(stderr=True)
    if len(missing) < len(plan):
        console.print(f"{len(plan) - len(missing)} of {len(plan)} scans are there already", soft_wrap=True)
    begun = time.perf_counter()
    _make_all(config, options, missing, console)
    seconds = time.perf_counter() - begun
    if missing:
        console.print(
            f"{len(missing)} scans in {seconds:.0f} s, {seconds / len(missing):.2f} s each; {config.output}",
            soft_wrap=True,
            highlight=False,
        )
    if config.json is not None:
        write_result(config.json, {"scans": len(plan), "made": len(missing), "seconds": seconds})
    return 0


def _make_all(
    config: Simulate, options: SimulationOptions, missing: list[PlannedScan], console: Console
) -> None:
    # One person's hand is prepared once: a worker takes all poses of it that are missing.
    hands: dict[tuple[int, str], list[PlannedScan]] = {}
    for scan in missing:
        hands.setdefault((scan.subject, scan.side), []).append(scan)
    pieces = [part for scans in hands.values() for part in _pieces(scans)]
    make_pieces(partial(make_scans, config.output, options), pieces, len(missing), config.workers, console)


def _pieces(scans: list[PlannedScan]) -> list[list[PlannedScan]]:
    """Eight scans at a time, so that the bar moves and the last worker does not work alone for long."""
    return [scans[i : i + 8] for i in range(0, len(scans), 8)]


def make_scans(folder: Path, options: SimulationOptions, scans: list[PlannedScan]) -> int:
    """Make scans and write each with its truth; the truth comes last and says that the scan is whole."""
    for planned in scans:
        made = simulate_scan(planned, options)
        path = folder / "scans" / f"{planned.name}.ply"
        write_ply(path, made.points_mm.astype(np.float32), made.faces, colours=made.colours)
        write_bytes(path, spoiled_bytes(path.read_bytes(), planned.fault))
        _write_truth(_truth_file(folder, planned), made.truth)
    return len(scans)


def _write_truth(path: Path, truth: ScanTruth) -> None:
    arrays = {name: np.asarray(value) for name, value in dataclasses.asdict(truth).items()}
    arrays["template"] = arrays["template"].astype(np.float32)
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    write_bytes(path, buffer.getvalue())


def _truth_file(folder: Path, scan: PlannedScan) -> Path:
    return folder / "truth" / f"{scan.name}.npz"


def _write_session(folder: Path, options: SimulationOptions, plan: tuple[PlannedScan, ...]) -> None:
    subjects = subjects_of(options)
    content: dict[str, Any] = {
        "format": _FORMAT,
        "unit": "mm",
        "made_by": f"corporeal {corporeal.__version__} simulate",
        "options": dataclasses.asdict(options),
        "scans": [
            {
                "name": scan.name,
                "file": f"scans/{scan.name}.ply",
                "subject": subjects[scan.subject].name,
                "protocol_pose": scan.protocol_pose,
                "side": scan.side,
            }
            for scan in plan
        ],
    }
    path = folder / "session.json"
    try:
        # Sessions of before there was this option hold the share that it has by default.
        check_same(path, content["options"], {"natural_share": NATURAL_SHARE})
        write_json(path, content)
        for part in ("scans", "truth"):
            (folder / part).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CommandError(f"{folder}: cannot be written: {error.strerror or error}", 2) from error


def _check_call(config: Simulate) -> None:
    for name in ("sequences", "frames"):
        if getattr(config, name) is not None:
            raise CommandError(f"--{name}: is for --body, not for sessions of hands", 2)
    for name in ("subjects", "poses"):
        value = getattr(config, name)
        if value is not None and value < 1:
            raise CommandError(f"--{name}: expected at least 1, got {value}", 2)
    if config.bad_one_in < 0 or config.workers < 0 or config.seed < 0:
        raise CommandError("--bad-one-in, --workers and --seed: expected 0 or more", 2)
    if not 0 <= config.natural_share <= 1:
        raise CommandError(f"--natural-share: expected 0 to 1, got {config.natural_share}", 2)
    if config.json is not None:
        check_result(config.json)
