"""The decisions of a curator on disk: one line each, appended and flushed before the page goes on."""

from __future__ import annotations

import json
import os
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from corporeal.atomic import write_bytes
from corporeal.view.decisions import DecisionHistory, Verdict


class DecisionFileError(ValueError):
    """The file of decisions cannot be used; the message names it and says what to do."""


class DecisionLog:
    """An append-only file of decisions; what it has returned from survives a crash.

    Attributes:
        history: the decisions so far.
        note: what had to be mended when the file was opened, or "".
    """

    def __init__(self, path: Path | str) -> None:
        """Read the decisions so far; a last line that a crash cut off is dropped, and ``note`` says so.

        Raises:
            DecisionFileError: the file cannot be read or written, or another line of it is no decision.
        """
        self._path = Path(path)
        self.note = ""
        try:
            content = self._path.read_bytes() if self._path.exists() else b""
            self.history = DecisionHistory.replayed(self._entries(content))
        except OSError as error:
            raise DecisionFileError(f"{self._path}: cannot be used: {error.strerror or error}") from error
        except ValueError as error:
            advice = "mend that line or move the file away"
            raise DecisionFileError(f"{self._path}: {error}; {advice}") from error

    def decide(self, name: str, verdict: Verdict) -> None:
        """Write a decision; it is on the disk when this returns.

        Raises:
            DecisionFileError: it cannot be written; nothing was decided then.
        """
        self._append(self.history.entry_for(name, verdict))

    def undo(self) -> str | None:
        """Take the last decision back; the name of its scan, or None where nothing was decided.

        Raises:
            DecisionFileError: it cannot be written; the decision stands then.
        """
        entry = self.history.entry_for_undo()
        if entry is None:
            return None
        self._append(entry)
        return str(entry["name"])

    def _append(self, entry: dict[str, Any]) -> None:
        line = json.dumps(entry | {"time": datetime.now(UTC).isoformat(timespec="milliseconds")})
        try:
            with self._path.open("ab") as file:
                end = file.tell()
                try:
                    file.write(line.encode() + b"\n")
                    file.flush()
                    os.fsync(file.fileno())
                except OSError:
                    # A full disk may have taken half of the line; the next one must not continue it.
                    os.truncate(self._path, end)
                    raise
        except OSError as error:
            raise DecisionFileError(f"{self._path}: cannot be written: {error.strerror or error}") from error
        self.history.record(entry)

    def _entries(self, content: bytes) -> list[dict[str, Any]]:
        whole, _, rest = content.rpartition(b"\n")
        lines = enumerate(whole.split(b"\n"), start=1)
        entries = [self._entry(line, number) for number, line in lines]
        if rest.strip():
            try:
                entries.append(self._entry(rest, len(entries) + 1))
                # Only its newline is missing; the next decision must not come onto the same line.
                self._mend(content + b"\n")
            except ValueError:
                self.note = f"{self._path.name}: the last line was cut off by a crash and has been dropped"
                self._mend(content[: len(content) - len(rest)])
        return [entry for entry in entries if entry is not None]

    def _entry(self, line: bytes, number: int) -> dict[str, Any] | None:
        if not line.strip():
            return None
        try:
            entry = json.loads(line)
        except ValueError as error:
            raise ValueError(f"line {number} is not JSON") from error
        if not isinstance(entry, dict):
            raise ValueError(f"line {number} is no decision")
        return entry

    def _mend(self, content: bytes) -> None:
        write_bytes(self._path, content)


def read_picture(path: Path) -> bytes | None:
    """The bytes of a picture, or None where it has not been drawn yet."""
    try:
        return path.read_bytes()
    except FileNotFoundError:
        return None
