"""Paired timing for every benchmark: two programs take turns, and the ratio of each pair is what counts.

A shared machine changes its speed from second to second. The two members of a pair run within milliseconds of
each other, so that the ratio of a pair is steady where the times are not; the median over the pairs is
reported, with the quartiles as its spread.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

SHORTEST_SAMPLE = 2e-3  # seconds; shorter calls are repeated, so that the clock's own cost does not count


@dataclass(frozen=True)
class Ratio:
    """Time of ours over time of theirs: median and quartiles over the pairs, and the median times."""

    median: float
    low: float
    high: float
    ours_seconds: float
    theirs_seconds: float


@dataclass(frozen=True)
class Row:
    """One line of a benchmark.

    Attributes:
        name: what was compared; the key in the baseline.
        ratio: the measured ratio, smaller is better.
        limit: the ratio that must not be passed, or None.
        remark: further figures, printed behind the line.
    """

    name: str
    ratio: Ratio
    limit: float | None = None
    remark: str = ""

    @property
    def within_limit(self) -> bool:
        """Whether the limit, if there is one, is kept."""
        return self.limit is None or self.ratio.median <= self.limit


def paired_ratio(ours: Callable[[], object], theirs: Callable[[], object], repeats: int) -> Ratio:
    """Time two calls in turn; every second pair runs in the other order.

    Both are called twice before the clock starts, which pays for compilation and caches.
    """
    counts = [_calls_per_sample(ours), _calls_per_sample(theirs)]
    samples = np.empty((repeats, 2))
    for repeat in range(repeats):
        for member in (0, 1) if repeat % 2 == 0 else (1, 0):
            samples[repeat, member] = _sample((ours, theirs)[member], counts[member])
    ratios = samples[:, 0] / samples[:, 1]
    low, median, high = np.quantile(ratios, [0.25, 0.5, 0.75])
    ours_seconds, theirs_seconds = np.median(samples, axis=0)
    return Ratio(float(median), float(low), float(high), float(ours_seconds), float(theirs_seconds))


def seconds(call: Callable[[], object], repeats: int) -> float:
    """Median time of one call."""
    count = _calls_per_sample(call)
    return float(np.median([_sample(call, count) for _ in range(repeats)]))


def report(
    title: str, rows: Sequence[Row], *, json_path: Path | None = None, baseline: Path | None = None,
    tolerance: float = 0.25,
) -> int:  # fmt: skip
    """Print a table, write it as JSON, compare it with a baseline.

    Args:
        title: the benchmark's name; the key of its rows in both files.
        rows: what was measured.
        json_path: where to store the rows; other benchmarks' rows in the same file are kept.
        baseline: a file that ``json_path`` wrote before.
        tolerance: how much a ratio may grow against the baseline, as a share of it.

    Returns:
        The exit status: 0, or 1 when a ratio is over its limit or has grown by more than the tolerance.
    """
    known = _stored(baseline).get(title, {}) if baseline else {}
    width = max(len(row.name) for row in rows)
    print(f"\n{title}: time ratio, ours / theirs (quartiles)")
    failed = False
    for row in rows:
        before = known.get(row.name, {}).get("ratio", {}).get("median")
        grown = before is not None and row.ratio.median > before * (1 + tolerance)
        failed |= grown or not row.within_limit
        print(_line(row, width, before, grown))
    if json_path:
        content = _stored(json_path)
        content[title] = {
            row.name: {"ratio": asdict(row.ratio), "limit": row.limit, "remark": row.remark} for row in rows
        }
        json_path.write_text(json.dumps(content, indent=1, sort_keys=True) + "\n")
    if failed:
        print("  a ratio is over its limit, or a ratio has grown against the baseline", file=sys.stderr)
    return int(failed)


def _line(row: Row, width: int, before: float | None, grown: bool) -> str:
    ratio = row.ratio
    parts = [
        f"  {row.name:<{width}}  {ratio.median:6.3f} ({ratio.low:.3f}-{ratio.high:.3f})",
        f"{1e3 * ratio.ours_seconds:9.3f} ms / {1e3 * ratio.theirs_seconds:9.3f} ms",
    ]
    if row.limit is not None:
        parts.append(f"limit {row.limit:.2f} {'ok' if row.within_limit else 'OVER'}")
    if before is not None:
        parts.append(f"baseline {before:.3f}{' GROWN' if grown else ''}")
    return "  ".join([*parts, row.remark]).rstrip()


def _stored(path: Path) -> dict:
    return json.loads(path.read_text()) if path.is_file() else {}


def _calls_per_sample(call: Callable[[], object]) -> int:
    call()
    call()
    once = _sample(call, 1)
    return max(1, round(SHORTEST_SAMPLE / max(once, 1e-7)))


def _sample(call: Callable[[], object], count: int) -> float:
    start = time.perf_counter()
    for _ in range(count):
        call()
    return (time.perf_counter() - start) / count
