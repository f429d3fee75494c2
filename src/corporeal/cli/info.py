"""``corporeal info``: what a model file or a scan holds."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from corporeal.cli.commands import Info
from corporeal.cli.errors import CommandError
from corporeal.cli.files import write_result
from corporeal.cli.named_models import named_model
from corporeal.model.files import LeftHandWarning, ModelFileError
from corporeal.model.formats.families import family_of_tree
from corporeal.model.surface_model import SurfaceModel

_MODEL_ENDINGS = {".npz", ".pkl"}


def run(config: Info) -> int:
    """Print the counts of one file.

    Raises:
        CommandError: the file cannot be read.
    """
    is_model = config.file.suffix.lower() in _MODEL_ENDINGS or not config.file.suffix
    content = _model_content(config.file) if is_model else _scan_content(config.file)
    Console().print(_table(content), highlight=False, soft_wrap=True)
    for warning in content["warnings"]:
        Console(stderr=True).print(warning, highlight=False, markup=False, soft_wrap=True)
    if config.json is not None:
        write_result(config.json, content)
    return 0


def described(model: SurfaceModel) -> dict[str, Any]:
    """The counts and names of a model, ready for JSON."""
    family = family_of_tree(model.parents)
    return {
        "name": model.name,
        "family": None if family is None else family.title,
        "side": model.side,
        "vertices": model.vertex_count,
        "faces": len(model.faces),
        "joints": model.joint_count,
        "shape": model.shape_count,
        "expression": model.expression_count,
        "correctives": model.pose_directions.shape[2],
        "blocks": [
            {
                "name": block.name,
                "joints": len(block.joints),
                "components": len(block.components),
                "mean_included": block.mean_included,
                "mixture": 0 if block.mixture is None else len(block.mixture.weights),
                "limits": block.limits is not None,
            }
            for block in model.pose_blocks
        ],
        "landmarks": {name: len(landmarks.names) for name, landmarks in model.landmarks.items()},
        "parts": {name: len(vertices) for name, vertices in model.parts.items()},
        "cut": None if model.cut is None else model.joint_names[model.cut.joint],
        "notes": dict(model.notes),
    }


def _model_content(path: Path) -> dict[str, Any]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", LeftHandWarning)
        try:
            model = named_model(path)
        except ModelFileError as error:
            raise CommandError(f"info: {error}") from error
    return {
        "file": str(path),
        "kind": "model",
        **described(model),
        "warnings": [str(warning.message) for warning in caught],
    }


def _scan_content(path: Path) -> dict[str, Any]:
    # Models are asked about more often; they need none of the scan readers.
    from corporeal.scans.files import SCAN_SUFFIXES, ScanFileError, read_scan

    if path.suffix.lower() not in SCAN_SUFFIXES:
        scans = ", ".join(SCAN_SUFFIXES)
        raise CommandError(f"info: {path}: expected .npz or .pkl for a model, or {scans} for a scan")

    from corporeal.scans.units import BODY_EXTENT, HAND_EXTENT

    try:
        try:
            scan = read_scan(path, expected_extent=HAND_EXTENT)
        except ScanFileError:
            scan = read_scan(path, expected_extent=BODY_EXTENT)
    except ScanFileError as error:
        raise CommandError(f"info: {error}") from error
    return {
        "file": str(path),
        "kind": "scan",
        "name": scan.name,
        "points": len(scan.points),
        "faces": len(scan.faces),
        "colours": scan.colours is not None,
        "unit": scan.unit.name,
        "diagonal_m": scan.diagonal,
        "repairs": list(scan.repairs),
        "warnings": [],
    }


def _table(content: dict[str, Any]) -> Table:
    table = Table(show_header=False, box=None, pad_edge=False)
    for key, value in content.items():
        if key != "warnings":
            table.add_row(key, Text("\n".join(_lines(value))))
    return table


def _lines(value: Any) -> list[str]:
    if isinstance(value, dict):
        return [f"{key}: {item}" for key, item in value.items()] or ["none"]
    if isinstance(value, list):
        return [_block_line(item) if isinstance(item, dict) else str(item) for item in value] or ["none"]
    if isinstance(value, bool):
        return ["yes" if value else "no"]
    if isinstance(value, float):
        return [f"{value:.3f}"]
    return ["none" if value is None else str(value)]


def _block_line(block: dict[str, Any]) -> str:
    plural = "" if block["joints"] == 1 else "s"
    parts = [f"{block['name']}: {block['joints']} joint{plural}"]
    if block["components"]:
        origin = "the mean" if block["mean_included"] else "the zero pose"
        parts.append(f"{block['components']} components counted from {origin}")
    if block["mixture"]:
        parts.append(f"mixture of {block['mixture']}")
    if block["limits"]:
        parts.append("limits")
    return ", ".join(parts)
