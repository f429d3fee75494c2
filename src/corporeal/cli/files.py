"""Machine-readable results on disk: written whole under a temporary name, then renamed."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from corporeal.atomic import write_bytes


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write JSON; numbers that are not finite become null, which JSON can say."""
    write_bytes(path, (json.dumps(_finite(content), indent=2, allow_nan=False) + "\n").encode())


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
