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

_PACKAGE = Path(__file__).resolve().parents[1]
_KERNELS = (
    "model/jacobian_kernels.py",
    "geometry/closest_points_kernels.py",
    "terms/mesh_pattern_kernels.py",
)


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


def check_output_folder(folder: Path, option: str = "-o") -> None:
    """Refuse a folder of results that cannot be made or written to; nothing is made.

    Raises:
        CommandError: a file stands in its way, or the rights are missing; status 2.
    """
    above = folder
    while not os.path.lexists(above) and above != above.parent:
        above = above.parent
    if not above.is_dir():
        raise CommandError(f"{option} {folder}: {above} is a file; name a folder", 2)
    if not os.access(above, os.W_OK | os.X_OK):
        raise CommandError(f"{option} {folder}: {above} cannot be written to", 2)


def can_be_opened(path: Path) -> bool:
    """Whether a file is there and may be read."""
    return path.is_file() and os.access(path, os.R_OK)


def kernels_are_compiled() -> bool:
    """Whether numba's cache holds the kernels that every registration runs, compiled from these sources."""
    return all(_is_compiled(_PACKAGE / kernels) for kernels in _KERNELS)


def _is_compiled(source: Path) -> bool:
    named = os.environ.get("NUMBA_CACHE_DIR")
    places = [Path(named)] if named else [source.parent / "__pycache__", Path.home() / ".cache" / "numba"]
    written = source.stat().st_mtime
    return any(
        index.stat().st_mtime >= written for place in places for index in place.rglob(f"{source.stem}.*.nbi")
    )


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
