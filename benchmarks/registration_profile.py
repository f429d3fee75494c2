"""Where the processor time of a registration goes, by stage, on one core.

Reads, registers and measures every scan given (files or folders), after one that warms the caches up, and
prints seconds of processor time per stage. Process start and imports are not counted: a worker pays for them
once. Stages inside others are indented.

    python benchmarks/registration_profile.py SCAN... [--single] [--limit SECONDS] [--most COUNT]
"""

from __future__ import annotations

import argparse
import functools
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch

from corporeal.model.files import open_model
from corporeal.registration import register as registering
from corporeal.registration import target as targets
from corporeal.registration.evidence import LandmarkFinder
from corporeal.registration.options import RegistrationOptions
from corporeal.registration.registration import Registration
from corporeal.registration.stages import Fitter
from corporeal.scans.detector import HandDetector
from corporeal.scans.files import SCAN_SUFFIXES, ScanFileError, read_scan
from corporeal.scans.virtual_cameras import Subject

ONE_CORE = {name: "1" for name in ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")}
# Row label -> (owner, attribute) of the functions whose time is counted there.
PARTS: dict[str, list[tuple[Any, str]]] = {
    "  pictures": [(Subject, "picture")],
    "  detector": [(HandDetector, "detect"), (HandDetector, "followed")],
    "  landmark fits": [(Fitter, "fit_landmarks")],
    "  surface stages": [(Fitter, "fit_surface")],
    "  free stages": [(Fitter, "fit_free")],
    "  samples, flat cut": [(targets, "sample_surface"), (targets, "flat_patch")],
    "  measure": [(registering, "_measured")],
}
ROWS = (
    "read and clean", "landmarks", "  pictures", "  detector", "fit", "  samples, flat cut",
    "  landmark fits", "  surface stages", "  free stages", "  measure", "total",
)  # fmt: skip


class Stopwatch:
    """Processor seconds by label for the scan at hand."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    def timed(self, label: str, call: Callable) -> Callable:
        """The same function, its time added to a label."""

        @functools.wraps(call)
        def wrapper(*arguments: Any, **named: Any) -> Any:
            begun = time.process_time()
            try:
                return call(*arguments, **named)
            finally:
                self.seconds[label] = self.seconds.get(label, 0.0) + time.process_time() - begun

        return wrapper


def scan_files(given: list[Path]) -> list[Path]:
    """The files given, and those in the folders given."""
    files: list[Path] = []
    for path in given:
        inside = sorted(path.rglob("*")) if path.is_dir() else [path]
        files += [file for file in inside if file.suffix.lower() in SCAN_SUFFIXES]
    return files


def profiled(path: Path, finder: LandmarkFinder, model: Any, options: Any, watch: Stopwatch) -> str:
    """Register one scan; its times stand in the watch, the sentence returned says how it ended."""
    watch.seconds = {}
    scan = watch.timed("read and clean", read_scan)(path)
    evidence, notes = watch.timed("landmarks", finder.find)(scan)
    found = watch.timed("fit", registering.register)(scan, model, evidence, options=options)
    watch.seconds["total"] = sum(
        watch.seconds.get(row, 0.0) for row in ("read and clean", "landmarks", "fit")
    )
    if not isinstance(found, Registration):
        return f"failed: {found.reason}"
    views = next((note for note in notes if "views" in note), "no views")
    mean = found.distances.summary_mm()["mean"]
    return f"{len(scan.points)} points, {views}, {found.side}, {found.status}, s2m {mean:.3f} mm"


def table(rows: list[dict[str, float]]) -> str:
    """Mean, median and most of every stage."""
    lines = [f"{'processor seconds':20} {'mean':>6} {'median':>6} {'most':>6}"]
    for name in ROWS:
        values = np.array([row.get(name, 0.0) for row in rows])
        lines.append(f"{name:20} {values.mean():6.2f} {np.median(values):6.2f} {values.max():6.2f}")
    return "\n".join(lines)


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scans", type=Path, nargs="+")
    parser.add_argument("--single", action="store_true", help="the options of single scans, not of sessions")
    parser.add_argument("--limit", type=float, default=np.inf, help="fail when the mean total is above it")
    parser.add_argument("--most", type=int, default=20, help="scans taken, evenly, of those given")
    given = parser.parse_args()
    if any(os.environ.get(name) != value for name, value in ONE_CORE.items()):
        # These are read as the libraries are loaded.
        os.execve(sys.executable, [sys.executable, *sys.argv], {**os.environ, **ONE_CORE})
    torch.set_num_threads(1)
    files = scan_files(given.scans)
    if not files:
        print("no scan found: nothing measured")
        return 1
    picked = np.unique(np.linspace(0, len(files) - 1, min(given.most, len(files))).astype(int))
    options = RegistrationOptions() if given.single else RegistrationOptions.for_sessions()
    watch, model, rows = Stopwatch(), open_model("hand"), []
    for label, functions in PARTS.items():
        for owner, name in functions:
            setattr(owner, name, watch.timed(label, getattr(owner, name)))
    with LandmarkFinder(model) as finder:
        for turn, number in enumerate([picked[0], *picked]):
            try:
                words = profiled(files[number], finder, model, options, watch)
            except ScanFileError as error:
                print(f"{files[number].name}: {error}")
                continue
            if turn > 0:
                rows.append(watch.seconds)
                print(f"{files[number].name}: {watch.seconds['total']:.2f} s, {words}", flush=True)
    if not rows:
        return 1
    print(table(rows))
    return 1 if np.mean([row["total"] for row in rows]) > given.limit else 0


if __name__ == "__main__":
    sys.exit(main())
