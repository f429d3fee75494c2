"""Landmarks given by the user: JSON or CSV, in the scan's own unit."""

from __future__ import annotations

import csv
import io
import json
import math
from pathlib import Path
from typing import Any

import numpy as np


class LandmarkFileError(ValueError):
    """A landmark file that cannot be used; the message names it and says what was expected."""


def read_landmarks(path: Path | str) -> dict[str, np.ndarray]:
    """Landmark name -> (3,) position in the unit of the file.

    Args:
        path: JSON, ``{"wrist": [x, y, z], ...}`` or ``{"names": [...], "points": [[x, y, z], ...]}``; or CSV
            with rows ``name,x,y,z`` (a heading is skipped).

    Raises:
        LandmarkFileError: the file is missing, of another form, or holds numbers that are not finite.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise LandmarkFileError(f"{path}: cannot be read: {error}") from error
    rows = _rows_of_csv(path, text) if path.suffix.lower() == ".csv" else _rows_of_json(path, text)
    landmarks: dict[str, np.ndarray] = {}
    for name, numbers in rows:
        if name in landmarks:
            raise LandmarkFileError(f"{path.name}: landmark {name!r} is given twice")
        landmarks[name] = _point(path, name, numbers)
    if not landmarks:
        raise LandmarkFileError(f"{path.name}: holds no landmark")
    return landmarks


def _rows_of_json(path: Path, text: str) -> list[tuple[str, Any]]:
    try:
        content = json.loads(text, object_pairs_hook=_pairs_once)
    except (ValueError, RecursionError) as error:
        raise LandmarkFileError(f"{path.name}: is no JSON: {error}") from error
    if not isinstance(content, dict):
        raise LandmarkFileError(f'{path.name}: expected {{"name": [x, y, z], ...}}')
    if set(content) >= {"names", "points"}:
        names, points = content["names"], content["points"]
        if not (isinstance(names, list) and isinstance(points, list) and len(names) == len(points)):
            raise LandmarkFileError(f"{path.name}: names and points must be lists of one length")
        return [(str(name), point) for name, point in zip(names, points, strict=True)]
    return [(str(name), point) for name, point in content.items()]


def _pairs_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """A JSON object; a repeated key, of which Python would keep the last in silence, is an error."""
    content = dict(pairs)
    if len(content) < len(pairs):
        raise ValueError("a name is given twice")
    return content


def _rows_of_csv(path: Path, text: str) -> list[tuple[str, Any]]:
    try:
        rows = [row for row in csv.reader(io.StringIO(text)) if row]
    except csv.Error as error:
        raise LandmarkFileError(f"{path.name}: is no CSV: {error}") from error
    if rows and [cell.strip().lower() for cell in rows[0][1:4]] == ["x", "y", "z"]:
        rows = rows[1:]
    return [(row[0].strip(), row[1:]) for row in rows]


def _point(path: Path, name: str, numbers: Any) -> np.ndarray:
    try:
        point = [float(number) for number in numbers]
    except (TypeError, ValueError) as error:
        raise LandmarkFileError(f"{path.name}: landmark {name!r} is no list of three numbers") from error
    if len(point) != 3 or not all(math.isfinite(number) for number in point):
        raise LandmarkFileError(f"{path.name}: landmark {name!r} needs three finite numbers, got {numbers}")
    return np.array(point)
