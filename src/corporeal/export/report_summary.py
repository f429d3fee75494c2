"""Figures of a registered session, from its rows and, where there is one, its truth."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

Row = Mapping[str, Any]


def summarise(
    items: Sequence[Row], truth_mm: Mapping[str, Mapping[str, float | None]] | None
) -> dict[str, Any]:
    """All figures of the report, of JSON's types.

    Args:
        items: the rows of the session, as ``corporeal register`` writes them.
        truth_mm: scan -> its errors against the truth by name, millimetres; None where there is no truth.
    """
    truth_mm = truth_mm or {}
    status_of = {item["name"]: str(item["status"]) for item in items}
    summary: dict[str, Any] = {
        "scans": len(items),
        "counts": dict(sorted(Counter(str(item["status"]) for item in items).items())),
        "s2m_mm": _of_numbers([value for item in items if (value := s2m(item)) is not None]),
        "seconds": _of_numbers([float(item["seconds"]["total"]) for item in items]),
        "poses": _groups(items, "protocol_pose", truth_mm),
        "subjects": _groups(items, "subject", truth_mm),
        "sides": _groups(items, "side", truth_mm),
        "failure_reasons": _reasons(items, "failed"),
        "doubt_reasons": _reasons(items, "doubtful"),
    }
    if truth_mm:
        summary["truth_mm"] = {
            "all registered": _of_errors(list(truth_mm.values())),
            "not failed": _of_errors(
                [errors for name, errors in truth_mm.items() if status_of.get(name, "failed") != "failed"]
            ),
            "ok": _of_errors([errors for name, errors in truth_mm.items() if status_of.get(name) == "ok"]),
        }
    return summary


def s2m(item: Row) -> float | None:
    """Mean scan-to-registration distance of a row, mm; None where there is none."""
    distances = item.get("s2m_mm")
    return None if not distances or distances["mean"] is None else float(distances["mean"])


def worst(
    items: Sequence[Row], truth_mm: Mapping[str, Mapping[str, float | None]] | None, count: int
) -> list[Row]:
    """The worst registrations first: by v2v where there is a truth, else by s2m.

    Scans without a registration have no distance; the failure reasons list them.
    """
    truth_mm = truth_mm or {}
    registered = [item for item in items if s2m(item) is not None]

    def badness(item: Row) -> tuple[float, float]:
        return (truth_mm.get(item["name"], {}).get("v2v") or 0.0, s2m(item) or 0.0)

    return sorted(registered, key=badness, reverse=True)[:count]


def _of_numbers(numbers: Sequence[float]) -> dict[str, Any] | None:
    if not numbers:
        return None
    return {
        "count": len(numbers),
        "mean": float(np.mean(numbers)),
        "median": float(np.median(numbers)),
        "p95": float(np.percentile(numbers, 95)),
        "max": float(np.max(numbers)),
    }


def _of_errors(errors: Sequence[Mapping[str, float | None]]) -> dict[str, Any]:
    """Every kind of error over scans: mean, median, 95th percentile and largest of the scans' means."""
    kinds: defaultdict[str, list[float]] = defaultdict(list)
    for scan in errors:
        for kind, value in scan.items():
            if value is not None:
                kinds[kind].append(value)
    return {kind: _of_numbers(values) for kind, values in kinds.items()}


def _groups(
    items: Sequence[Row], key: str, truth_mm: Mapping[str, Mapping[str, float | None]]
) -> list[dict[str, Any]]:
    """One row per pose, subject or side: counts by status and mean distances."""
    groups: defaultdict[str, list[Row]] = defaultdict(list)
    for item in items:
        groups[str(item.get(key) or "unknown")].append(item)
    rows = []
    for name, members in sorted(groups.items()):
        counts = Counter(item["status"] for item in members)
        distances = [value for item in members if (value := s2m(item)) is not None]
        errors = [truth_mm[item["name"]]["v2v"] for item in members if item["name"] in truth_mm]
        known = [error for error in errors if error is not None]
        rows.append(
            {
                "name": name,
                "scans": len(members),
                **{status: counts[status] for status in ("ok", "doubtful", "failed")},
                "s2m_mm": float(np.mean(distances)) if distances else None,
                "v2v_mm": float(np.mean(known)) if known else None,
            }
        )
    return rows


def _reasons(items: Sequence[Row], status: str) -> list[dict[str, Any]]:
    """How often each reason; numbers in it are left out, so that like reasons fall together."""
    examples: defaultdict[str, list[str]] = defaultdict(list)
    for item in items:
        if item["status"] == status:
            examples[_without_numbers(str(item["reason"]))].append(item["name"])
    ordered = sorted(examples.items(), key=lambda pair: (-len(pair[1]), pair[0]))
    return [{"reason": reason, "count": len(names), "example": names[0]} for reason, names in ordered]


def _without_numbers(reason: str) -> str:
    words = (
        "…" if any(mark.isdigit() for mark in word) and "/" not in word else word for word in reason.split()
    )
    return " ".join(words)
