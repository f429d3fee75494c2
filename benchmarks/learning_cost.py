"""What learning costs: time, memory and where the time goes, by the number of registrations.

Every count is learned in a process of its own, from a sample spread over all hands; a count beyond what is
there takes all. Kernels are compiled (or read from the cache) before the clock starts.

    python benchmarks/learning_cost.py REG... [--start start_hand] [--counts 250 500 1000 2000] [--json FILE]
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np
from rich.console import Console

from corporeal.cli.learn import gathered
from corporeal.cli.named_models import named_model
from corporeal.learning.learn import learn_model
from corporeal.learning.options import LearningOptions
from corporeal.learning.training_set import TrainingSet

WARMING = 60


def sample(training: TrainingSet, count: int) -> TrainingSet:
    """So many registrations, spread evenly over the list, in which those of one hand stand together."""
    if count >= len(training.names):
        return training
    order = np.lexsort((training.names, training.hands))
    return training.subset(np.sort(order[np.linspace(0, len(order) - 1, count).round().astype(int)]))


def measured(registrations: list[Path], start_name: str, count: int) -> dict:
    """Learn once; seconds by step, the whole, and the process's largest memory."""
    start = named_model(Path(start_name))
    training = gathered(registrations, start)
    learn_model(sample(training, WARMING), start, LearningOptions(sweeps=2))
    chosen = sample(training, count)
    begun = time.monotonic()
    learned = learn_model(chosen, start, LearningOptions())
    seconds = time.monotonic() - begun
    steps: Counter[str] = Counter()
    for entry in learned.log:
        steps[entry.step] += entry.seconds
    steps["statistics and the rest"] = seconds - sum(steps.values())
    return {
        "registrations": len(chosen.names),
        "hands": len(set(chosen.hands)),
        "seconds": seconds,
        "rms_mm": learned.log[-1].rms_mm,
        "peak_gib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20,
        "steps": dict(steps.most_common()),
    }


def print_rows(rows: list[dict]) -> None:
    """One line per count, then where the time of the largest goes."""
    print(f"{'registrations':>14}{'hands':>7}{'seconds':>9}{'peak GiB':>10}{'rms mm':>8}")
    for row in rows:
        print(
            f"{row['registrations']:14d}{row['hands']:7d}{row['seconds']:9.1f}{row['peak_gib']:10.2f}"
            f"{row['rms_mm']:8.3f}"
        )
    largest = rows[-1]
    print(f"\nof {largest['registrations']} registrations:")
    for step, seconds in largest["steps"].items():
        print(f"  {step:26s}{seconds:7.1f} s {100 * seconds / largest['seconds']:5.1f} %")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("registrations", type=Path, nargs="+")
    parser.add_argument("--start", default="start_hand")
    parser.add_argument("--counts", type=int, nargs="+", default=[250, 500, 1000, 2000])
    parser.add_argument("--json", type=Path)
    parser.add_argument("--one", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one is not None:
        print(json.dumps(measured(options.registrations, options.start, options.one)))
        return
    rows = []
    for count in options.counts:
        command = [sys.executable, __file__, *map(str, options.registrations), "--start", options.start]
        done = subprocess.run([*command, "--one", str(count)], capture_output=True, text=True, check=False)
        if done.returncode:
            Console(stderr=True).print(done.stderr, markup=False)
            raise SystemExit(f"{count} registrations: not learned, see above")
        rows.append(json.loads(done.stdout.splitlines()[-1]))
    print_rows(rows)
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
