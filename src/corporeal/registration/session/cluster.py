"""The same jobs on dask.distributed."""

from __future__ import annotations

import contextlib
import logging
import queue
import uuid
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from corporeal.registration.session.jobs import AnySetup, NamedJob, News, WorkerError, lost_record


class DaskMissingError(ImportError):
    """dask.distributed is not installed."""


def run_dask(
    setup: AnySetup, jobs: Iterable[NamedJob], address: str, workers: int,
    lost: Callable[[Any, str], Any] = lost_record,
) -> Iterator[tuple[Any, Any]]:  # fmt: skip
    """Run jobs on a cluster; the setup goes once to every worker, also to those that join later.

    Its workers read the scans themselves: the session must lie at the same path for all. Numbers agree with
    those of the local pool where the workers' BLAS has one thread, as dask sets it for the workers it starts.

    Args:
        setup: sent once per worker.
        jobs: what to do.
        address: of a scheduler, or "local" for processes on this machine.
        workers: how many, for "local".
        lost: makes the record of a job whose workers were lost again and again.

    Yields:
        A record per job, in the order in which they are finished; ``News`` of workers that tell, of which the
        last may be late and then are left out.

    Raises:
        DaskMissingError: dask.distributed is not installed.
        WorkerError: the scheduler cannot be reached, or a worker says that no scan can succeed.
    """
    try:
        from distributed import Client

        from corporeal.registration.session.dask_worker import NAME, SessionWorkerPlugin, run_on_worker
    except ImportError as error:
        raise DaskMissingError('dask is not installed (pip install "corporeal[dask]")') from error
    waiting = iter(jobs)
    with contextlib.ExitStack() as stack:
        cluster = stack.enter_context(_local_cluster(workers)) if address == "local" else address
        try:
            client = stack.enter_context(Client(cluster, set_as_default=False))
        except (OSError, TimeoutError, ValueError) as error:
            raise WorkerError(f"--dask {address}: no scheduler answers there ({error})") from error
        # Schedulers keep topics: one of an earlier run must not be heard again.
        topic, heard = f"{NAME}-{uuid.uuid4().hex}", queue.SimpleQueue[Any]()
        client.register_plugin(SessionWorkerPlugin(setup, topic))
        stack.callback(client.unregister_worker_plugin, NAME)
        client.subscribe_topic(topic, lambda event: heard.put(event[1]))
        stack.callback(client.unsubscribe_topic, topic)
        # Two per thread: the next scan is there when one is done, and few are lost with a worker.
        width = 2 * max(sum(client.nthreads().values()), 1)
        running: dict[str, tuple[NamedJob, Any]] = {}

        def submit() -> None:
            while len(running) < width and (job := next(waiting, None)) is not None:
                future = client.submit(run_on_worker, job, pure=False)
                running[job.name] = (job, future)
                future.add_done_callback(lambda _, name=job.name: heard.put((name, None)))

        submit()
        while running:
            name, content = heard.get()
            if name not in running:
                continue
            job, future = running[name]
            if content is None:
                del running[name]
                record = _result(future, job, lost)
                submit()
                yield job, record
            else:
                yield job, News(content)


def _result(future: Any, job: NamedJob, lost: Callable[[Any, str], Any]) -> Any:
    from distributed import KilledWorker

    try:
        return future.result()
    except KilledWorker:
        return lost(job, "its dask worker was lost again and again")
    except WorkerError:
        raise
    except Exception as error:
        raise WorkerError(f"dask: a task could not be run: {error!r}") from error


def _local_cluster(workers: int) -> Any:
    from distributed import LocalCluster

    return LocalCluster(
        n_workers=workers,
        threads_per_worker=1,
        processes=True,
        dashboard_address="127.0.0.1:0",  # A free port: the usual one may be taken, which dask warns of.
        silence_logs=logging.ERROR,
    )
