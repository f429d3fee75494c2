"""Machine-readable results on disk: written whole under a temporary name, then renamed."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from corporeal.atomic import write_bytes
from corporeal.cli.errors import CommandError


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write JSON; numbers that are not finite become null, which JSON can say."""
    write_bytes(path, (json.dumps(_finite(content), indent=2, allow_nan=False) + "\n").encode())


def write_result(path: Path, content: Mapping[str, Any]) -> None:
    """Write the file that ``--json`` names; ``CommandError`` where it cannot be written."""
    try:
        write_json(path, content)
    except OSError as error:
        raise CommandError(f"--json {path}: cannot be written: {error.strerror or error}") from error


def check_result(path: Path) -> None:
    """Refuse a ``--json`` that cannot be written before any work is done."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CommandError(f"--json {path}: cannot be written: {error.strerror or error}", 2) from error
    if path.is_dir() or not os.access(path.parent, os.W_OK):
        raise CommandError(f"--json {path}: is a folder, or lies in one that cannot be written to", 2)


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
