"""What both simulations share: work spread over processes, and folders that continue only as they began."""

from __future__ import annotations

import json
import multiprocessing
import os
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from corporeal.cli.errors import CommandError
from corporeal.registration.session.pool import single_threaded


def make_pieces(
    make: Callable[[Any], int], pieces: Sequence[Any], total: int, workers: int, console: Console
) -> None:
    """Run pieces of work in processes of one thread each, with a bar.

    Args:
        make: makes a piece and says how many scans it was; picklable.
        pieces: what it is called with.
        total: scans in all.
        workers: processes; 0 for one per core.
        console: where the bar is drawn.

    Raises:
        CommandError: the disk is full or cannot be written.
    """
    columns = (
        TextColumn("simulating"), BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[rate]}"),
        TimeRemainingColumn(),
    )  # fmt: skip
    count = min(workers or os.cpu_count() or 1, max(len(pieces), 1))
    context = multiprocessing.get_context("spawn")
    with (
        # The workers share the cores, and sums keep their order, so that bytes repeat.
        single_threaded(),
        ProcessPoolExecutor(count, mp_context=context) as pool,
        Progress(*columns, console=console, transient=True) as progress,
    ):
        task = progress.add_task("", total=total, rate="")
        begun, done = time.perf_counter(), 0
        futures = [pool.submit(make, piece) for piece in pieces]
        try:
            for future in as_completed(futures):
                done += future.result()
                rate = (time.perf_counter() - begun) / max(done, 1)
                progress.update(task, completed=done, rate=f"{rate:.2f} s a scan")
        except OSError as error:
            pool.shutdown(cancel_futures=True)
            raise CommandError(f"a scan cannot be written: {error}") from error
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def check_same(path: Path, options: Mapping[str, Any], defaults: Mapping[str, Any]) -> None:
    """Refuse to continue a folder that was begun with other options.

    Args:
        path: of the list that the simulation writes first.
        options: of now, of JSON's types.
        defaults: of options that lists of before may not hold.

    Raises:
        CommandError: it was begun otherwise, or is no such list.
    """
    if not path.exists():
        return
    try:
        before = {**defaults, **json.loads(path.read_text()).get("options", {})}
    except (ValueError, AttributeError, TypeError) as error:
        raise CommandError(f"{path}: is no list of a simulation: {error}", 2) from error
    changed = [name for name, value in options.items() if before.get(name) != value]
    if changed:
        words = ", ".join(f"--{name.replace('_', '-')} {before.get(name)}" for name in changed)
        raise CommandError(
            f"{path.parent}: was begun with {words}; continue with that or take another folder", 2
        )
