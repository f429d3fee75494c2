"""What a folder of results was made from, and whether a resumed session still fits to it."""

from __future__ import annotations

import hashlib
import json
import platform
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

import corporeal
from corporeal.registration.session.files import SessionFolderError
from corporeal.scans.formats.session import CaptureSession

FORMAT = "corporeal-registrations-1"


def new_manifest(session: CaptureSession, description: Mapping[str, Any]) -> dict[str, Any]:
    """The manifest of a session.

    Args:
        session: what is registered.
        description: "model" with name and sha256, and "options", of JSON's types.
    """
    scans = {scan.name: asdict(scan) for scan in session.scans}
    return {
        "format": FORMAT,
        "versions": {
            "corporeal": corporeal.__version__,
            "python": platform.python_version(),
            "numpy": np.__version__,
        },
        "model": dict(description["model"]),
        "options": dict(description["options"]),
        "options_sha256": digest(description["options"]),
        "session": {"path": str(session.folder), "unit": session.unit, "sha256": digest(scans)},
        "scans": scans,
        "round": 1,
    }


def check_same(old: Mapping[str, Any], new: Mapping[str, Any]) -> list[str]:
    """Whether results made under the old manifest may be continued under the new one.

    Scans may be added. Another version of a library is said, not refused.

    Returns:
        Sentences to tell the user.

    Raises:
        SessionFolderError: model, options or the known scans differ; the message names every difference.
    """
    if old.get("format") != FORMAT:
        raise SessionFolderError(
            f"the manifest's format is {old.get('format')!r}, expected {FORMAT!r}; choose another folder, or "
            "redo it with --restart"
        )
    changes = [f"the model: {line}" for line in changes_between(old["model"], new["model"])]
    changes += [f"option {line}" for line in changes_between(old["options"], new["options"])]
    known = {name: new["scans"].get(name) for name in old["scans"]}
    gone = sorted(name for name, scan in known.items() if scan is None)
    changes += [f"scan {name} is no longer in the session" for name in gone[:3]]
    kept = {name: scan for name, scan in known.items() if scan is not None}
    changes += [f"scan {line}" for line in changes_between({name: old["scans"][name] for name in kept}, kept)]
    changes += [f"the session's unit: {line}" for line in changes_between(
        {"unit": old["session"]["unit"]}, {"unit": new["session"]["unit"]})]  # fmt: skip
    if changes:
        shown = "; ".join(changes[:6]) + ("; ..." if len(changes) > 6 else "")
        raise SessionFolderError(
            f"since these results were begun, this has changed: {shown}. Put it back, choose another folder, "
            "or redo all with --restart"
        )
    notes = [f"another version of {line}" for line in changes_between(old["versions"], new["versions"])]
    added = len(new["scans"]) - len(old["scans"])
    return notes + ([f"{added} scans were added to the session"] if added else [])


def digest(content: Any) -> str:
    """SHA-256 of JSON, whatever the order of its keys."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def changes_between(old: Any, new: Any) -> list[str]:
    """A sentence "key: before -> now" for everything in which two JSON contents differ."""
    before, now = _flat(old), _flat(new)
    missing = "absent"
    return [
        f"{key}: {before.get(key, missing)} -> {now.get(key, missing)}"
        for key in sorted(before.keys() | now.keys())
        if before.get(key, missing) != now.get(key, missing)
    ]


def _flat(value: Any, prefix: str = "") -> dict[str, Any]:
    """Nested keys joined by dots."""
    if isinstance(value, Mapping):
        items = [(str(key), item) for key, item in value.items()]
    elif isinstance(value, list | tuple):
        items = [(str(number), item) for number, item in enumerate(value)]
    else:
        return {prefix: value}
    flat: dict[str, Any] = {}
    for key, item in items:
        flat |= _flat(item, f"{prefix}.{key}" if prefix else key)
    return flat
