"""``corporeal report``: one HTML file on a registered session."""

from __future__ import annotations

import dataclasses
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from rich.console import Console

from corporeal.cli.commands import Report
from corporeal.cli.errors import CommandError
from corporeal.cli.files import check_result, write_result
from corporeal.cli.session_pictures import SessionPictures, model_of
from corporeal.export.report import Report as Page
from corporeal.export.report import write_report
from corporeal.export.report_summary import s2m, summarise, worst
from corporeal.export.thumbnails import thumbnail_png
from corporeal.model.mirror import mirror_model
from corporeal.model.pose import FullPose
from corporeal.model.surface_model import SurfaceModel
from corporeal.registration.ground_truth import errors_against_truth, flagging
from corporeal.registration.session.files import MANIFEST, SessionFolderError, read_json_file, read_records
from corporeal.registration.session.records import RecordError, SessionRecord

_WORST = 10
_PICTURE = (300, 360)


def run(config: Report) -> int:
    """Write the report."""
    if config.json is not None:
        check_result(config.json)
    try:
        records = read_records(config.folder)
        manifest = read_json_file(config.folder / MANIFEST) or {}
    except (RecordError, SessionFolderError) as error:
        raise CommandError(str(error), 2) from error
    if not records:
        raise CommandError(f"{config.folder}: holds no records yet; nothing is there to report")
    model = model_of(config.folder)
    session = config.session or _session_of(manifest)
    truth_mm = _errors(records, session, model)
    items = [record.row for record in records]
    summary = summarise(items, truth_mm)
    if truth_mm is not None:
        statuses = {item["name"]: item["status"] for item in items}
        flags = flagging(statuses, {name: errors["v2v"] for name, errors in truth_mm.items()})
        summary["flagging"] = dataclasses.asdict(flags)
    pictures = SessionPictures(config.folder, config.session, model)
    by_name = {record.name: record for record in records}
    figures = []
    for row in worst(items, truth_mm, _WORST):
        picture = pictures.picture(by_name[row["name"]])
        figures.append((row, thumbnail_png(picture, _PICTURE), _words(row, truth_mm)))
    output = config.output or config.folder / "report.html"
    try:
        title = f"Registrations of {session.name if session else config.folder.name}"
        write_report(output, Page(title, items, summary, figures, truth_mm, manifest))
    except OSError as error:
        raise CommandError(f"-o {output}: cannot be written: {error.strerror or error}", 2) from error
    if config.json is not None:
        write_result(config.json, {"items": items, "summary": summary, "truth_mm": truth_mm})
    counts = ", ".join(f"{count} {status}" for status, count in summary["counts"].items())
    line = f"{output}: {len(items)} scans: {counts}"
    Console(stderr=True).print(line, highlight=False, soft_wrap=True, markup=False)
    return 0


def _session_of(manifest: Mapping[str, Any]) -> Path | None:
    named = manifest.get("session")
    path = named.get("path") if isinstance(named, dict) else named
    return Path(path) if path else None


def _errors(
    records: list[SessionRecord], session: Path | None, model: SurfaceModel
) -> dict[str, dict[str, float | None]] | None:
    """Scan -> errors against its truth, mm, all None without a registration; None without a truth.

    Raises:
        CommandError: a truth cannot be read or is not that of this model.
    """
    folder = None if session is None else session / "truth"
    if folder is None or not folder.is_dir():
        return None
    models = {model.side: model}
    if model.side is not None:
        mirrored = mirror_model(model)
        models[mirrored.side] = mirrored
    found: dict[str, dict[str, float | None]] = {}
    for record in records:
        path = folder / f"{record.name}.npz"
        if not path.exists():
            continue
        try:
            with np.load(path, allow_pickle=False) as truth:
                found[record.name] = _error(record, models[record.side or model.side], truth)
        except (OSError, ValueError, KeyError, zipfile.BadZipFile) as error:
            raise CommandError(f"{path}: not the truth of this scan: {error}", 2) from error
    return found or None


def _error(record: SessionRecord, model: SurfaceModel, truth: Mapping[str, Any]) -> dict[str, float | None]:
    if record.vertices is None or record.pose is None or record.shape is None or record.translation is None:
        return dict.fromkeys(("v2v", "v2v_p95", "v2v_max", "normal", "tangential", "joints"))
    template, joints = truth["template"], truth["joints"]
    if template.shape != record.vertices.shape:
        raise ValueError(f"it has {len(template)} vertices, the registration {len(record.vertices)}")
    shape, pose, translation = (
        torch.tensor(np.asarray(numbers), dtype=torch.float64)[None]
        for numbers in (record.shape, record.pose, record.translation)
    )
    fitted_joints = model(shape, FullPose(pose), None, translation).joints[0].numpy()
    errors = errors_against_truth(
        record.vertices, template.astype(np.float64), model.faces, fitted_joints, joints
    )
    return dataclasses.asdict(errors)


def _words(row: Mapping[str, Any], truth_mm: Mapping[str, Mapping[str, float | None]] | None) -> str:
    words = f"s2m {s2m(row) or 0:.2f} mm"
    v2v = (truth_mm or {}).get(row["name"], {}).get("v2v")
    return words if v2v is None else f"{words}, v2v {v2v:.2f} mm"
