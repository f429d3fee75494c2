"""What is to be done with one scan of a session, and who does it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Literal, Protocol, runtime_checkable

from corporeal.registration.gaussian_pose import GaussianPose
from corporeal.registration.rows import failed_row
from corporeal.registration.session.files import sha256_of
from corporeal.registration.session.records import KnownLandmarks, SessionRecord


class WorkerError(RuntimeError):
    """No scan's fault: workers cannot start, or cannot write. The session stops, and can resume."""


@dataclass(frozen=True, eq=False)
class ScanJob:
    """One scan to register.

    Attributes:
        name: of the scan in its session.
        path: of its file.
        subject: whose hand it is, or None.
        protocol_pose: what pose was asked for, or None.
        side: where it is known.
        round_number: 1 with the neutral pose prior, 2 with that of the protocol pose.
        prior: the prior of the second round.
        landmarks: what the detector found in this scan before, or None.
    """

    name: str
    path: str
    subject: str | None = None
    protocol_pose: str | None = None
    side: Literal["left", "right"] | None = None
    round_number: int = 1
    prior: GaussianPose | None = None
    landmarks: KnownLandmarks | None = None

    def completed(self, row: dict[str, Any], sha256: str | None) -> dict[str, Any]:
        """A scan's row with all that the session knows of it."""
        return row | {
            "name": self.name,
            "subject": self.subject,
            "protocol_pose": self.protocol_pose,
            "side": row["side"] or self.side,
            "round": self.round_number,
            "sha256": sha256,
        }


@runtime_checkable
class Worker(Protocol):
    """Registers scans one after the other; made once per process."""

    def __call__(self, job: ScanJob) -> SessionRecord:
        """One record; a bad scan does not raise, ``WorkerError`` stops the session."""

    def close(self) -> None:
        """Let go of the detector."""


@dataclass(frozen=True, eq=False)
class News:
    """What a worker tells while it works on a job: of JSON's types.

    Attributes:
        content: whatever the worker and who listens have agreed on.
    """

    content: dict[str, Any]


@runtime_checkable
class TellingWorker(Protocol):
    """A worker whose jobs are long; whoever runs it puts in ``tell`` where its news go.

    ``tell`` raises where nobody listens any more; the worker lets that through, and ends.
    """

    tell: Callable[[dict[str, Any]], None]


@runtime_checkable
class NamedJob(Protocol):
    """What the pool and dask need to know of a job."""

    @property
    def name(self) -> str:
        """Unique among the jobs."""


@runtime_checkable
class AnySetup(Protocol):
    """All that a worker of whatever jobs needs, picklable: sent once to every process."""

    def start(self) -> Any:
        """Called in the worker's process; gives what is called with a job, and has ``close``."""


@runtime_checkable
class WorkerSetup(Protocol):
    """All that a worker needs, picklable: sent once to every process."""

    def start(self) -> Worker:
        """Called in the worker's process."""


Execute = Callable[[WorkerSetup, Iterable[ScanJob]], Iterator[tuple[ScanJob, SessionRecord]]]
"""Runs jobs somewhere; yields records in any order."""


def lost_record(job: ScanJob, reason: str) -> SessionRecord:
    """The record of a scan that its worker did not survive."""
    return SessionRecord(job.completed(failed_row(job.path, reason, {}, []), sha256_of(job.path)))
