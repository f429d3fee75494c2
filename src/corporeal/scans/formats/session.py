"""A capture session on disk: a folder of scans, and what is known of each."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, Literal

from corporeal.scans.units import UnitChoice

FORMAT = "corporeal-session-1"
LIST = "session.json"
_UNITS = ("auto", "m", "cm", "mm", "free")


class SessionFileError(ValueError):
    """A folder is no session; the message names what is wrong in it and what was expected."""


@dataclass(frozen=True)
class SessionScan:
    """One scan of a session.

    Attributes:
        name: unique in the session; results are called after it.
        file: the scan, relative to the session's folder.
        subject: whose hand it is, or None where nothing is known.
        protocol_pose: name of the pose that was asked for, or None.
        side: "left" or "right", or None.
    """

    name: str
    file: str
    subject: str | None = None
    protocol_pose: str | None = None
    side: Literal["left", "right"] | None = None


@dataclass(frozen=True)
class CaptureSession:
    """The scans of a folder, sorted by name; ``unit`` is that of their files."""

    folder: Path
    scans: tuple[SessionScan, ...]
    unit: UnitChoice = "auto"


def read_session(folder: Path, suffixes: tuple[str, ...]) -> CaptureSession:
    """Read ``session.json``, or take every scan of a folder that has none for a session.

    Scans are not opened, and need not exist: one that is missing costs its own row later.

    Args:
        folder: of the session.
        suffixes: endings of scan files in lower case, for a folder without a list.

    Raises:
        SessionFileError: the list cannot be read, breaks its format, or there are no scans.
    """
    folder = folder.resolve()
    path = folder / LIST
    try:
        if path.exists():
            return _listed(folder, json.loads(path.read_text()))
        files = sorted(entry for entry in folder.iterdir() if entry.suffix.lower() in suffixes)
    except (OSError, ValueError) as error:
        raise SessionFileError(f"{path}: {error}") from error
    if not files:
        raise SessionFileError(f"{folder}: holds no {LIST} and no file that ends in {', '.join(suffixes)}")
    scans = tuple(SessionScan(file.stem, file.name) for file in files)
    _check_names(folder, scans)
    return CaptureSession(folder, scans)


def _listed(folder: Path, content: Any) -> CaptureSession:
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise ValueError(f'expected an object with "format": "{FORMAT}"')
    unit = content.get("unit", "auto")
    if unit not in _UNITS:
        raise ValueError(f'unknown "unit" {unit!r}; expected one of {", ".join(_UNITS)}')
    entries = content.get("scans")
    if not isinstance(entries, list) or not entries:
        raise ValueError('expected a list "scans" with at least one entry')
    scans = tuple(sorted((_scan(entry) for entry in entries), key=lambda scan: scan.name))
    _check_names(folder, scans)
    return CaptureSession(folder, scans, unit)


def _scan(entry: Any) -> SessionScan:
    if not isinstance(entry, dict):
        raise ValueError(f"expected an object for every scan, got {entry!r}")
    name, file, side = entry.get("name"), entry.get("file"), entry.get("side")
    if not isinstance(name, str) or not name or name.startswith(".") or set(name) & set("/\\\0"):
        raise ValueError(f"{name!r} cannot be the name of a scan: results are files of that name")
    if not isinstance(file, str) or PurePosixPath(file).is_absolute() or ".." in PurePosixPath(file).parts:
        raise ValueError(f"scan {name!r}: its file {file!r} must lie in the session's folder")
    if side not in ("left", "right", None):
        raise ValueError(f'scan {name!r}: unknown side {side!r}; expected "left", "right" or null')
    for key in ("subject", "protocol_pose"):
        if not isinstance(entry.get(key), str | None):
            raise ValueError(f"scan {name!r}: its {key} must be a text or null")
    return SessionScan(name, file, entry.get("subject"), entry.get("protocol_pose"), side)


def _check_names(folder: Path, scans: tuple[SessionScan, ...]) -> None:
    name, count = Counter(scan.name for scan in scans).most_common(1)[0]
    if count > 1:
        raise SessionFileError(f"{folder}: {count} scans are named {name!r}; results would fall together")
