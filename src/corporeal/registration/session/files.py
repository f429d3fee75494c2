"""The folder of a registered session on disk: records, manifest and the list of items."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from corporeal.atomic import write_bytes
from corporeal.registration.gaussian_pose import GaussianPose
from corporeal.registration.session.records import (
    KnownLandmarks,
    RecordError,
    SessionRecord,
    decode_record,
    encode_record,
    zipped,
)

MANIFEST = "manifest.json"
MODEL = "model.npz"
"""A copy of the model, so that the records can be read when the file that it came from has changed."""
ITEMS = "session.json"
DECISIONS = "decisions.jsonl"
PRIORS = "priors.npz"
_READING_OPTIONS = ("unit", "green_objects")


class RecordMissingError(RecordError):
    """There is no such record."""


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
        RecordError: it is damaged.
        RecordMissingError: there is none.
    """
    path = Path(path)
    try:
        content = path.read_bytes()
    except FileNotFoundError as error:
        raise RecordMissingError(f"{path}: cannot be read ({error.strerror})") from error
    except OSError as error:
        raise RecordError(f"{path}: cannot be read ({error.strerror or error})") from error
    return decode_record(content, str(path))


def remove_record(path: Path) -> None:
    """Remove a record that no longer holds."""
    path.unlink(missing_ok=True)


def has_records(folder: Path | str) -> bool:
    """Whether any record lies in a folder of results."""
    return any(record_folder(folder).glob("*.npz"))


def make_folder(folder: Path | str) -> None:
    """Make the folder of results where it is missing; ``OSError`` where it cannot be."""
    Path(folder).mkdir(parents=True, exist_ok=True)


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


def read_landmarks(folder: Path | str, options: Mapping[str, Any]) -> dict[str, KnownLandmarks]:
    """Name of a scan -> the landmarks that an earlier registration found in it.

    Args:
        folder: what ``corporeal register`` wrote to.
        options: of the registration that will use them; what the detector was shown depends on some of them.

    Raises:
        RecordError: there is no such folder, or a record in it is damaged.
        SessionFolderError: the scans were read otherwise there, or its manifest cannot be read.
    """
    known = {
        record.name: record.known_landmarks("an earlier registration") for record in read_records(folder)
    }
    before = (read_json_file(Path(folder) / MANIFEST) or {}).get("options", {})
    for name in _READING_OPTIONS:
        if before.get(name) != options[name]:
            raise SessionFolderError(
                f"{folder}: its landmarks were found with {name} {before.get(name)}, and now it is "
                f"{options[name]}; register with the same, or without its landmarks"
            )
    return {name: landmarks for name, landmarks in known.items() if landmarks is not None}


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


def write_priors(folder: Path | str, priors: Mapping[str, GaussianPose]) -> None:
    """Write the pose priors of the second round: a resumed session must not learn them from its results."""
    names = sorted(priors)
    arrays = {"names": np.array(names, dtype=np.str_)}
    for number, name in enumerate(names):
        prior = priors[name]
        arrays |= {f"mean_{number}": prior.mean, f"covariance_{number}": prior.covariance}
        arrays[f"side_{number}"] = np.array(prior.side or "")
    write_bytes(Path(folder) / PRIORS, zipped(arrays))


def read_priors(folder: Path | str) -> dict[str, GaussianPose] | None:
    """Protocol pose -> prior, or None before the second round.

    Raises:
        SessionFolderError: the file is damaged.
    """
    path = Path(folder) / PRIORS
    if not path.exists():
        return None
    try:
        with np.load(path, allow_pickle=False) as archive:
            return {
                str(name): GaussianPose(
                    archive[f"mean_{number}"],
                    archive[f"covariance_{number}"],
                    str(archive[f"side_{number}"]) or None,  # type: ignore[arg-type]
                )
                for number, name in enumerate(archive["names"])
            }
    except Exception as error:  # Damaged bytes make the zip and npy parsers raise nearly anything.
        raise SessionFolderError(f"{path}: damaged ({error}); use --restart") from error


def file_stamps(paths: Mapping[str, Path]) -> dict[str, list[int] | None]:
    """Name -> [bytes, time of the last change in ns], or None for a file that is missing."""
    stamps: dict[str, list[int] | None] = {}
    for name, path in paths.items():
        try:
            status = path.stat()
        except OSError:
            stamps[name] = None
        else:
            stamps[name] = [status.st_size, status.st_mtime_ns]
    return stamps


def remove_results(folder: Path | str) -> list[str]:
    """Clear a folder for a new start, the manifest last; decisions are put aside. Says what was kept."""
    folder, kept = Path(folder), []
    for path in record_folder(folder).glob("*.npz"):
        path.unlink()
    for name in (PRIORS, ITEMS, MODEL, MANIFEST):
        (folder / name).unlink(missing_ok=True)
    decisions = folder / DECISIONS
    if decisions.exists():
        number = 1
        while (aside := folder / f"decisions-{number}.jsonl").exists():
            number += 1
        os.replace(decisions, aside)
        kept.append(f"{decisions.name} speaks of the old results: kept as {aside.name}")
    return kept


def remove_leftovers(folder: Path | str) -> None:
    """Drop the temporary files of a process that was killed while it wrote."""
    for where in (Path(folder), record_folder(folder)):
        for path in where.glob(".*.tmp"):
            path.unlink(missing_ok=True)


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


def sha256_of(path: Path | str) -> str | None:
    """Hash of a file's content, or None where it cannot be read."""
    try:
        with open(path, "rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return None
