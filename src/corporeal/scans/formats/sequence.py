"""A sequence of scans on disk: one folder, one subject, frames in order."""

from __future__ import annotations

import json
import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from corporeal.scans.units import UnitChoice

FORMAT = "corporeal-sequence-1"
LIST = "sequence.json"
DEFAULT_FPS = 60.0
_UNITS = ("auto", "m", "cm", "mm")


class SequenceFileError(ValueError):
    """A folder is no sequence; the message names what is wrong in it and what was expected."""


@dataclass(frozen=True)
class SequenceFrame:
    """One frame: a name that is unique in the sequence, and the scan's file."""

    name: str
    path: Path


@dataclass(frozen=True)
class ScanSequence:
    """The frames of a folder in order.

    Attributes:
        name: results are called after it.
        folder: of the sequence.
        frames: in order of time.
        fps: frames per second.
        subject: who it is, or None where nothing is known.
        unit: of the scans' files.
        notes: sentences on what was assumed.
    """

    name: str
    folder: Path
    frames: tuple[SequenceFrame, ...]
    fps: float = DEFAULT_FPS
    subject: str | None = None
    unit: UnitChoice = "auto"
    notes: tuple[str, ...] = ()


def read_sequence(folder: Path, suffixes: tuple[str, ...]) -> ScanSequence:
    """Read ``sequence.json``, or take every scan of a folder that has none, in the order of their numbers.

    Scans are not opened, and need not exist: one that is missing costs its own row later.

    Args:
        folder: of the sequence.
        suffixes: endings of scan files in lower case, for a folder without a list.

    Raises:
        SequenceFileError: the list cannot be read, breaks its format, or there are no scans.
    """
    folder = folder.resolve()
    path = folder / LIST
    try:
        if path.exists():
            return _listed(folder, json.loads(path.read_text()))
        files = [entry for entry in folder.iterdir() if entry.suffix.lower() in suffixes]
    except (OSError, ValueError) as error:
        raise SequenceFileError(f"{path}: {error}") from error
    if not files:
        raise SequenceFileError(f"{folder}: holds no {LIST} and no file that ends in {', '.join(suffixes)}")
    frames = tuple(SequenceFrame(file.stem, file) for file in sorted(files, key=lambda f: _natural(f.name)))
    _check_names(folder, frames)
    note = f"no {LIST}: frames in the order of their names, taken as {DEFAULT_FPS:g} a second"
    return ScanSequence(folder.name, folder, frames, notes=(note,))


def _natural(name: str) -> list[tuple[int, str]]:
    """Numbers in names count as numbers: frame 10 comes after frame 9."""
    parts = re.split(r"(\d+)", name)
    return [(int(part), "") if part.isdigit() else (-1, part) for part in parts]


def _listed(folder: Path, content: Any) -> ScanSequence:
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise ValueError(f'expected an object with "format": "{FORMAT}"')
    unit, fps, subject = content.get("unit", "auto"), content.get("fps", DEFAULT_FPS), content.get("subject")
    if unit not in _UNITS:
        raise ValueError(f'unknown "unit" {unit!r}; expected one of {", ".join(_UNITS)}')
    if isinstance(fps, bool) or not isinstance(fps, int | float) or not 0 < fps < 1e5:
        raise ValueError(f'"fps": expected frames per second, got {fps!r}')
    if not isinstance(subject, str | None):
        raise ValueError('"subject" must be a text or null')
    name = _checked_name(content.get("name", folder.name))
    entries = content.get("frames")
    if not isinstance(entries, list) or not entries:
        raise ValueError('expected a list "frames" with at least one entry')
    frames = tuple(_frame(folder, entry) for entry in entries)
    _check_names(folder, frames)
    return ScanSequence(name, folder, frames, float(fps), subject, unit)


def _frame(folder: Path, entry: Any) -> SequenceFrame:
    if not isinstance(entry, dict):
        raise ValueError(f"expected an object for every frame, got {entry!r}")
    name, file = _checked_name(entry.get("name")), entry.get("file")
    if not isinstance(file, str) or PurePosixPath(file).is_absolute() or ".." in PurePosixPath(file).parts:
        raise ValueError(f"frame {name!r}: its file {file!r} must lie in the sequence's folder")
    return SequenceFrame(name, folder / file)


def _checked_name(name: Any) -> str:
    if not isinstance(name, str) or not name or name.startswith(".") or set(name) & set("/\\\0"):
        raise ValueError(f"{name!r} cannot be a name: results are files of that name")
    return name


def _check_names(folder: Path, frames: tuple[SequenceFrame, ...]) -> None:
    name, count = Counter(frame.name for frame in frames).most_common(1)[0]
    if count > 1:
        raise SequenceFileError(f"{folder}: {count} frames are named {name!r}; results would fall together")
