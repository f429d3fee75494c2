"""``corporeal register``: raw scans in, articulated hands out."""

from __future__ import annotations

import os
import time
import traceback
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from corporeal.cli.commands import Register
from corporeal.cli.errors import CommandError
from corporeal.cli.files import (
    can_be_opened,
    check_output_folder,
    check_result,
    kernels_are_compiled,
    write_json,
    write_result,
)
from corporeal.cli.named_models import named_model
from corporeal.cli.registration_outputs import remove_outputs, write_outputs
from corporeal.cli.session import SessionCall, run_session
from corporeal.model.files import ModelFileError
from corporeal.model.surface_model import SurfaceModel
from corporeal.registration.evidence import LandmarkFinder
from corporeal.registration.register import register
from corporeal.registration.registration import FailedRegistration
from corporeal.registration.rows import failed_row, registered_row
from corporeal.registration.subjects import subject_of
from corporeal.scans.files import ScanFileError, read_scan
from corporeal.scans.scan import Scan
from corporeal.scans.segmentation import remove_object


def run(config: Register) -> int:
    """Register every scan; one bad scan costs one row."""
    _check_call(config)
    model = _model(config.model)
    console = Console(stderr=True, markup=False, highlight=False, soft_wrap=True)
    if not kernels_are_compiled():
        console.print("the first run compiles kernels, for about a minute; later runs find them compiled")
    if config.scans[0].is_dir():
        return run_session(_session_call(config), model)
    items: list[dict[str, Any]] = []
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TextColumn("{task.completed}/{task.total}"),
        TimeElapsedColumn(),
    )
    with (
        _finder(model, config.landmarks) as finder,
        Progress(*columns, console=console, transient=True) as progress,
    ):
        task = progress.add_task("registering", total=len(config.scans))
        for path in config.scans:
            items.append(
                _one(path, model, finder, config, lambda step: progress.update(task, description=step))
            )
            progress.advance(task)
    for item in items:
        console.print(_line(item))
    if config.json is not None:
        write_result(config.json, {"items": items})
    if len(items) > 1:
        counts = Counter(item["status"] for item in items)
        console.print(", ".join(f"{count} {status}" for status, count in sorted(counts.items())))
        return 0
    return 1 if items[0]["status"] == "failed" else 0


def _one(
    path: Path, model: SurfaceModel, finder: LandmarkFinder, config: Register, on_step: Any
) -> dict[str, Any]:
    begun = time.perf_counter()
    seconds = {"landmarks": 0.0, "fit": 0.0}
    folder = config.output / path.stem
    try:
        remove_outputs(folder)
        on_step(f"{path.name}: reading")
        subject = subject_of(model)
        scan = read_scan(path, unit=config.unit, expected_extent=subject.extent)
        if config.green_objects:
            scan = _without_object(scan)
        on_step(f"{path.name}: landmarks")
        marked = time.perf_counter()
        evidence, notes = finder.find(scan)
        seconds["landmarks"] = time.perf_counter() - marked
        marked = time.perf_counter()
        result = register(
            scan, model, evidence, None if config.side == "auto" else config.side,
            replace(subject.options(), correctives=config.correctives),
            lambda step: on_step(f"{path.name}: {step}"),
        )  # fmt: skip
        seconds["fit"] = time.perf_counter() - marked
        if isinstance(result, FailedRegistration):
            row = failed_row(str(path), result.reason, seconds, notes)
        else:
            on_step(f"{path.name}: writing")
            row = registered_row(str(path), result, seconds, notes)
            row["outputs"] = write_outputs(result, folder, row)
    except (ScanFileError, ScanContentError, OSError) as error:
        row = failed_row(str(path), str(error), seconds, [])
    except Exception as error:
        # One scan must never cost the others; a fault of ours is reported as one, with its place.
        place = traceback.extract_tb(error.__traceback__)[-1]
        reason = f"internal error, please report it: {error!r} in {Path(place.filename).name}:{place.lineno}"
        row = failed_row(str(path), reason, seconds, [])
    row["seconds"]["total"] = time.perf_counter() - begun
    if not (folder.exists() or can_be_opened(path)):
        return row
    try:
        write_json(folder / "report.json", row)
    except OSError as error:
        row |= {"status": "failed", "reason": f"{folder}: results could not be written: {error}"}
    return row


class ScanContentError(ValueError):
    """A scan that was read but does not allow what was asked."""


def _without_object(scan: Scan) -> Scan:
    try:
        return remove_object(scan)
    except ValueError as error:
        raise ScanContentError(f"--green-objects: {error}") from error


def _finder(model: SurfaceModel, landmarks: Path | None) -> LandmarkFinder:
    try:
        return LandmarkFinder(model, landmarks)
    except (ValueError, OSError) as error:
        raise CommandError(f"--landmarks: {error}", 2) from error


def _session_call(config: Register) -> SessionCall:
    return SessionCall(
        folder=config.scans[0],
        output=config.output,
        workers=(os.cpu_count() or 1) if config.workers is None else config.workers,
        rounds=config.rounds,
        dask=config.dask,
        restart=config.restart,
        outputs=config.outputs,
        side=None if config.side == "auto" else config.side,
        unit=config.unit,
        correctives=config.correctives,
        green_objects=config.green_objects,
        json=config.json,
        landmarks_from=config.landmarks_from,
    )


def _check_call(config: Register) -> None:
    if not config.scans:
        raise CommandError("register: name at least one scan file", 2)
    folders = [path for path in config.scans if path.is_dir()]
    if folders and len(config.scans) > 1:
        raise CommandError(f"register: {folders[0]} is a folder; give one session, or scan files", 2)
    if folders and config.landmarks is not None:
        raise CommandError("register: --landmarks goes with one scan, not with a session", 2)
    for_sessions = {
        "--workers": config.workers is not None,
        "--rounds": config.rounds != 1,
        "--dask": config.dask is not None,
        "--restart": config.restart,
        "--outputs": config.outputs,
        "--landmarks-from": config.landmarks_from is not None,
    }
    given = [name for name, is_given in for_sessions.items() if is_given]
    if given and not folders:
        raise CommandError(f"register: {given[0]} goes with the folder of a session, not with scan files", 2)
    stems = Counter(path.stem for path in config.scans)
    twice = [stem for stem, count in stems.items() if count > 1]
    if twice:
        raise CommandError(f"register: two scans named {twice[0]!r} would write to one folder; rename one", 2)
    check_output_folder(config.output)
    for path in () if folders else config.scans:
        check_output_folder(config.output / path.stem)
    if config.json is not None:
        check_result(config.json)
    if config.landmarks is not None and len(config.scans) > 1:
        raise CommandError("register: --landmarks goes with one scan, not with several", 2)


def _model(name: str) -> SurfaceModel:
    try:
        return named_model(Path(name))
    except ModelFileError as error:
        raise CommandError(f"--model {error}", 2) from error


def _line(item: dict[str, Any]) -> str:
    if item["s2m_mm"] is None:
        return f"{item['scan']}: {item['status']} - {item['reason']}"
    return (
        f"{item['scan']}: {item['status']}, {item['side'] or 'no side'}, unit {item['unit']}, "
        f"s2m {item['s2m_mm']['mean']:.2f} mm (model alone {item['model_s2m_mm']['mean']:.2f}), "
        f"{item['seconds']['total']:.1f} s - {item['reason']}"
    )
