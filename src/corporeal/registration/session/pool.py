"""A pool of local processes that knows which scan each of them works on.

``concurrent.futures`` breaks as a whole when one process dies and cannot tell whose fault it was; its workers
outlive a parent that was killed. Here a dead worker costs its own scan a second try, and workers end when
their parent does.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from multiprocessing import connection
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any

from corporeal.registration.session.jobs import (
    AnySetup,
    NamedJob,
    News,
    TellingWorker,
    WorkerError,
    lost_record,
)

_TRIES = 2
_FAILED_STARTS = 3
# Ten times the slowest scan seen (search over orientations without a unit): whoever takes longer hangs.
_LONGEST_SECONDS = 600.0
_THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
    "NUMBA_NUM_THREADS",
)


def run_local(
    setup: AnySetup, jobs: Iterable[NamedJob], workers: int, longest: float = _LONGEST_SECONDS,
    lost: Callable[[Any, str], Any] = lost_record,
) -> Iterator[tuple[Any, Any]]:  # fmt: skip
    """Run jobs in ``workers`` spawned processes of one thread each.

    One thread also for a single worker: sums over several threads round otherwise, and results must not
    depend on the number of workers.

    Args:
        setup: pickled once for every process.
        jobs: what to do.
        workers: how many processes.
        longest: seconds without news after which a job's worker is ended as if it had died.
        lost: makes the record of a job whose worker died twice without news in between.

    Yields:
        A record per job, in the order in which they are finished; before it, ``News`` of workers that tell.

    Raises:
        WorkerError: workers cannot start, or one says that no scan can succeed.
    """
    pool = _Pool(setup, deque(jobs), longest, lost)
    try:
        pool.staff(workers)
        while pool.has_work:
            yield from pool.step()
    finally:
        pool.close()


@dataclass(eq=False)
class _Seat:
    """A process and what it does."""

    process: BaseProcess
    pipe: Connection
    ready: bool = False
    job: NamedJob | None = None
    deadline: float = float("inf")


class _Pool:
    def __init__(
        self, setup: AnySetup, queue: deque[Any], longest: float, lost: Callable[[Any, str], Any]
    ) -> None:
        self._setup = setup
        self._queue = queue
        self._longest = longest
        self._lost = lost
        self._seats: list[_Seat] = []
        self._deaths: Counter[str] = Counter()
        self._failed_starts = 0

    @property
    def has_work(self) -> bool:
        return bool(self._queue) or any(seat.job is not None for seat in self._seats)

    def staff(self, workers: int) -> None:
        for _ in range(min(workers, len(self._queue))):
            self._seats.append(self._seated())

    def step(self) -> Iterator[tuple[Any, Any]]:
        """Hand out jobs and wait for news."""
        for seat in self._seats:
            if seat.ready and seat.job is None and self._queue:
                self._give(seat, self._queue.popleft())
        nearest = min((seat.deadline for seat in self._seats), default=float("inf"))
        timeout = None if nearest == float("inf") else max(nearest - time.monotonic(), 0.0)
        connection.wait(
            [part for seat in self._seats for part in (seat.pipe, seat.process.sentinel)], timeout
        )
        for seat in list(self._seats):
            yield from self._news(seat)

    def close(self) -> None:
        for seat in self._seats:
            seat.pipe.close()
            # Killed, not asked: it writes no results, and may be in the middle of a scan.
            seat.process.kill()
        for seat in self._seats:
            seat.process.join()
        self._seats.clear()

    def _seated(self) -> _Seat:
        context = multiprocessing.get_context("spawn")
        ours, theirs = context.Pipe()
        process = context.Process(target=_serve, args=(theirs, self._setup), daemon=True)
        with single_threaded():
            process.start()
        theirs.close()
        return _Seat(process, ours)

    def _give(self, seat: _Seat, job: NamedJob) -> None:
        try:
            seat.pipe.send(job)
        except (BrokenPipeError, ConnectionResetError):
            # It died while it was idle: no fault of this scan's. Its sentinel tells; another gets the job.
            self._queue.append(job)
            return
        seat.job, seat.deadline = job, time.monotonic() + self._longest

    def _news(self, seat: _Seat) -> Iterator[tuple[Any, Any]]:
        message = _received(seat.pipe)
        if message is not None:
            yield from self._message(seat, *message)
        elif not seat.process.is_alive():
            yield from self._replaced(seat, f"exit code {seat.process.exitcode}")
        elif time.monotonic() >= seat.deadline:
            seat.process.kill()
            yield from self._replaced(seat, f"it took longer than {self._longest:g} s")

    def _message(self, seat: _Seat, kind: str, content: Any) -> Iterator[tuple[Any, Any]]:
        if kind == "unable":
            raise WorkerError(content)
        if kind == "ready":
            seat.ready, self._failed_starts = True, 0
        elif seat.job is not None and kind == "news":
            seat.deadline = time.monotonic() + self._longest
            del self._deaths[seat.job.name]
            yield seat.job, News(content)
        elif seat.job is not None:
            job, seat.job, seat.deadline = seat.job, None, float("inf")
            yield job, content

    def _replaced(self, seat: _Seat, how: str) -> Iterator[tuple[Any, Any]]:
        seat.process.join()
        seat.pipe.close()
        if not seat.ready:
            self._failed_starts += 1
            if self._failed_starts >= _FAILED_STARTS:
                raise WorkerError(f"workers end before their first scan ({how}); is there enough memory?")
        self._seats[self._seats.index(seat)] = self._seated()
        if seat.job is not None:
            self._deaths[seat.job.name] += 1
            if self._deaths[seat.job.name] < _TRIES:
                self._queue.append(seat.job)
                return
            yield seat.job, self._lost(seat.job, f"its worker process was lost twice ({how})")


def _received(pipe: Connection) -> tuple[str, Any] | None:
    try:
        return pipe.recv() if pipe.poll() else None
    except (EOFError, OSError):
        return None


def _serve(pipe: Connection, setup: AnySetup) -> None:
    """A worker's life; it ends with its parent, whose end of the pipe closes then."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's to handle.
    with contextlib.suppress(EOFError, BrokenPipeError, ConnectionResetError):
        try:
            worker = setup.start()
            if isinstance(worker, TellingWorker):
                worker.tell = lambda content: pipe.send(("news", content))
            pipe.send(("ready", None))
            while True:
                pipe.send(("record", worker(pipe.recv())))
        except WorkerError as error:
            pipe.send(("unable", str(error)))
        except Exception as error:
            if isinstance(error, EOFError | BrokenPipeError | ConnectionResetError):
                raise
            pipe.send(("unable", f"internal error in a worker, please report it: {error!r}"))


@contextlib.contextmanager
def single_threaded() -> Iterator[None]:
    """Processes begun in this block have one thread each.

    BLAS reads its number of threads when it is loaded: children inherit it from our environment.
    """
    before = {name: os.environ.get(name) for name in _THREAD_VARIABLES}
    os.environ.update(dict.fromkeys(_THREAD_VARIABLES, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
