"""The folder of a registered session on disk: records, manifest and the list of items."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

from corporeal.atomic import write_bytes
from corporeal.registration.session.records import RecordError, SessionRecord, decode_record, encode_record

MANIFEST = "manifest.json"
ITEMS = "session.json"
DECISIONS = "decisions.jsonl"


class SessionFolderError(ValueError):
    """The folder of results cannot be used; the message names the file and says what to do."""


def record_folder(folder: Path | str) -> Path:
    """Where the records of a registered session lie."""
    return Path(folder) / "records"


def record_path(folder: Path | str, name: str) -> Path:
    """Where the record of one scan lies."""
    return record_folder(folder) / f"{name}.npz"


def write_record(path: Path | str, record: SessionRecord) -> None:
    """Write a record whole or not at all.

    Raises:
        OSError: it cannot be written: no right to, or no room; nothing is left behind.
    """
    write_bytes(path, encode_record(record))


def read_record(path: Path | str) -> SessionRecord:
    """Read a record.

    Raises:
        RecordError: there is none, or it is damaged.
    """
    path = Path(path)
    try:
        content = path.read_bytes()
    except OSError as error:
        raise RecordError(f"{path}: cannot be read ({error.strerror or error})") from error
    return decode_record(content, str(path))


def read_records(folder: Path | str) -> list[SessionRecord]:
    """All records of a registered session, sorted by name.

    Args:
        folder: what ``corporeal register`` wrote to (its ``records`` folder is read).

    Raises:
        RecordError: there is no such folder, or a record in it is damaged; none is skipped.
    """
    where = record_folder(folder)
    if not where.is_dir():
        raise RecordError(f"{folder}: holds no records; give the folder that corporeal register wrote to")
    records = [read_record(path) for path in sorted(where.glob("*.npz"))]
    return sorted(records, key=lambda record: record.name)


def read_decisions(folder: Path | str) -> dict[str, str]:
    """Name of a scan -> what the curator decided of it last: "accept" or "reject".

    Raises:
        SessionFolderError: a line, other than a last one cut off by a crash, is no decision.
    """
    path = Path(folder) / DECISIONS
    if not path.exists():
        return {}
    decisions: dict[str, str] = {}
    lines = path.read_text().split("\n")
    for number, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        try:
            entry = json.loads(line)
            name, decision = entry["name"], entry["decision"]
        except (ValueError, KeyError, TypeError) as error:
            if number == len(lines):
                continue
            raise SessionFolderError(f"{path}: line {number} is no decision; mend or remove it") from error
        if decision == "undo":
            decisions.pop(name, None)
        else:
            decisions[name] = decision
    return decisions


def write_json_file(path: Path, content: Any) -> None:
    """Write JSON whole or not at all; the same content gives the same bytes."""
    write_bytes(path, (json.dumps(content, indent=2, sort_keys=True, allow_nan=False) + "\n").encode())


def read_json_file(path: Path) -> dict[str, Any] | None:
    """The object in a JSON file, or None where there is no file.

    Raises:
        SessionFolderError: it cannot be read, or holds something else.
    """
    try:
        content = json.loads(path.read_text())
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        raise SessionFolderError(f"{path}: cannot be read ({error}); remove it, or use --restart") from error
    if not isinstance(content, dict):
        raise SessionFolderError(f"{path}: expected a JSON object; remove it, or use --restart")
    return content


def sha256_of(path: Path) -> str | None:
    """Hash of a file's content, or None where it cannot be read."""
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return None
