"""What each part of tracking is worth: a window of every simulated sequence, tracked again without it.

    python benchmarks/capture_ablation.py CAPTURE TRACKED [--frames 38] [--workers 2] [--variants NAME ...]

CAPTURE is what ``corporeal simulate CAPTURE --body`` wrote, TRACKED what ``corporeal track`` did with it. The
window of a sequence begins four frames before a hand or forearm is lost for at least eight frames, so that
the loss, the return and the recovery lie in it; it starts from what was tracked before, with the same
template. The columns are those of ``benchmarks/tracking.py``.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import tempfile
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from tracking import COLUMNS, HANDS, Score, Truth, line, scored
from tracking_ablation import VARIANTS

from corporeal.fitting.bridged_records import bridge_records
from corporeal.fitting.files import (
    TEMPLATE,
    FrameRecord,
    frame_path,
    load_subject_template,
    read_frame,
    write_frame,
)
from corporeal.fitting.track import Tracker
from corporeal.registration.subjects import BODY
from corporeal.scans.files import read_scan
from corporeal.scans.simulation.bodies.motion import FPS

NAMES = (
    "as it is", "no velocity term", "single Gaussian", "flat hands", "six components", "no finger search"
)  # fmt: skip
BEFORE, SHORTEST = 4, 8


def window(sequence: Path, tracked: Path, count: int) -> list[str]:
    """Names of the frames, the one before the first of them in front."""
    names = sorted(path.stem for path in (tracked / "frames").glob("*.npz"))
    truth = Truth(sequence, load_subject_template(tracked).model)
    missing = [truth.missing(name) for name in names]
    for hand in HANDS:
        for first in range(BEFORE + 1, len(names) - SHORTEST):
            lost = hand in missing[first] and hand not in missing[first - 1]
            if lost and all(hand in missing[first + step] for step in range(SHORTEST)):
                return names[first - BEFORE - 1 : first - BEFORE + count]
    return names[: count + 1]


def measured(sequence: Path, tracked: Path, variant: str, count: int) -> Score:
    """One sequence's window by one variant."""
    before, *names = window(sequence, tracked, count)
    state = read_frame(frame_path(tracked, before)).state
    template = load_subject_template(tracked)
    tracker = Tracker(template, VARIANTS[variant], state)
    with tempfile.TemporaryDirectory() as folder:
        again = Path(folder)
        (again / "frames").mkdir()
        (again / TEMPLATE).symlink_to((tracked / TEMPLATE).resolve())
        for name in names:
            scan = read_scan(sequence / "scans" / f"{name}.ply", "mm", BODY.extent)
            write_frame(frame_path(again, name), FrameRecord(tracker.step(scan, name), tracker.state))
        bridge_records(again, names, template.model, FPS, {})
        return scored(sequence, again, 1)


def main() -> None:
    """Print a row per variant, over all sequences."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("capture", type=Path)
    parser.add_argument("tracked", type=Path)
    parser.add_argument("--frames", type=int, default=38)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--variants", nargs="*", default=list(NAMES), choices=list(VARIANTS))
    asked = parser.parse_args()
    folders = sorted(path.parent for path in asked.tracked.glob(f"*/{TEMPLATE}"))
    heads = " ".join(f"{column:>6}" for column in COLUMNS)
    print(f"{'':16} {heads} {'turn':>6} {'back':>14} {'ok/?/failed':>12} {'s/frame':>8}")
    for name in ("OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[name] = "1"  # of the workers, which are started anew
    with ProcessPoolExecutor(asked.workers, multiprocessing.get_context("spawn")) as pool:
        for variant in asked.variants:
            jobs = [
                pool.submit(measured, asked.capture / folder.name, folder, variant, asked.frames)
                for folder in folders
            ]
            total = Score()
            for job in jobs:
                total.add(job.result())
            print(line(variant, total.row()), flush=True)


if __name__ == "__main__":
    main()
