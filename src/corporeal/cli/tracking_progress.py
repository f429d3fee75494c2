"""How the user is told of sequences that are being tracked, and of what came out."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn

from corporeal.cli.tracking_job import SequenceJob

_STATUSES = ("ok", "doubtful", "failed")


class SequenceBars:
    """A bar for every sequence that is begun: seconds per frame, counts by status, the present step."""

    def __init__(self, console: Console) -> None:
        columns = (
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            TextColumn("{task.completed:.0f}/{task.total:.0f}"),
            TextColumn("{task.fields[words]}", markup=False),
        )
        self._console = console
        self._progress = Progress(*columns, console=console, transient=True)
        self._tasks: dict[str, TaskID] = {}
        self._begun: dict[str, tuple[float, int]] = {}

    def __enter__(self) -> SequenceBars:
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._progress.stop()

    def note(self, sentence: str) -> None:
        """Something that the user should know."""
        self._console.print(sentence)

    def told(self, job: SequenceJob, content: Mapping[str, Any]) -> None:
        """News of a worker."""
        if "note" in content:
            self.note(f"{job.name}: {content['note']}")
            return
        task = self._task(job)
        if "step" in content:
            self._progress.update(task, words=content["step"])
            return
        done = int(content["done"])
        moment, first = self._begun.setdefault(job.name, (time.monotonic(), done))
        speed = f"{(time.monotonic() - moment) / (done - first):.2f} s/frame, " if done > first else ""
        words = f"{speed}{counted(content['statuses'])}"
        self._progress.update(task, completed=done, words=words)

    def ended(self, job: SequenceJob, outcome: Mapping[str, Any]) -> None:
        """A sequence is done; its bar makes room."""
        if job.name in self._tasks:
            self._progress.remove_task(self._tasks.pop(job.name))
        self.note(outcome_line(outcome))

    def _task(self, job: SequenceJob) -> TaskID:
        if job.name not in self._tasks:
            total = len(job.sequence.frames)
            self._tasks[job.name] = self._progress.add_task(job.name, total=total, words="")
        return self._tasks[job.name]


def counted(statuses: Mapping[str, int]) -> str:
    """Counts in words."""
    return ", ".join(f"{statuses.get(status, 0)} {status}" for status in _STATUSES)


def outcome_line(outcome: Mapping[str, Any]) -> str:
    """One sequence in one line: counts, distance, time, and where its results are."""
    if outcome["reason"] is not None:
        return f"{outcome['name']}: failed - {outcome['reason']}; {outcome['folder']}"
    distance = "" if outcome["s2m_mm"] is None else f", s2m {outcome['s2m_mm']:.2f} mm"
    return (
        f"{outcome['name']}: {counted(outcome['statuses'])}{distance}, {outcome['seconds']:.2f} s/frame; "
        f"{outcome['folder']}"
    )
