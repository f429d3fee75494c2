"""The same jobs on dask.distributed."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Iterable, Iterator
from typing import Any

from corporeal.registration.session.jobs import ScanJob, WorkerError, WorkerSetup, lost_record
from corporeal.registration.session.records import SessionRecord


class DaskMissingError(ImportError):
    """dask.distributed is not installed."""


def run_dask(
    setup: WorkerSetup, jobs: Iterable[ScanJob], address: str, workers: int
) -> Iterator[tuple[ScanJob, SessionRecord]]:
    """Run jobs on a cluster; the setup goes once to every worker, also to those that join later.

    Its workers read the scans themselves: the session must lie at the same path for all. Numbers agree with
    those of the local pool where the workers' BLAS has one thread, as dask sets it for the workers it starts.

    Args:
        setup: sent once per worker.
        jobs: what to do.
        address: of a scheduler, or "local" for processes on this machine.
        workers: how many, for "local".

    Yields:
        A record per job, in the order in which they are finished.

    Raises:
        DaskMissingError: dask.distributed is not installed.
        WorkerError: the scheduler cannot be reached, or a worker says that no scan can succeed.
    """
    try:
        from distributed import Client, as_completed

        from corporeal.registration.session.dask_worker import NAME, SessionWorkerPlugin, register_on_worker
    except ImportError as error:
        raise DaskMissingError('dask is not installed (pip install "corporeal[dask]")') from error
    queue = iter(jobs)
    with contextlib.ExitStack() as stack:
        cluster = stack.enter_context(_local_cluster(workers)) if address == "local" else address
        try:
            client = stack.enter_context(Client(cluster, set_as_default=False))
        except (OSError, TimeoutError, ValueError) as error:
            raise WorkerError(f"--dask {address}: no scheduler answers there ({error})") from error
        client.register_plugin(SessionWorkerPlugin(setup))
        stack.callback(client.unregister_worker_plugin, NAME)
        # Two per thread: the next scan is there when one is done, and few are lost with a worker.
        width = 2 * max(sum(client.nthreads().values()), 1)
        running: dict[Any, ScanJob] = {}
        finished = as_completed(loop=client.loop)

        def submit() -> None:
            for job in queue:
                future = client.submit(register_on_worker, job, pure=False)
                running[future] = job
                finished.add(future)
                if len(running) >= width:
                    break

        submit()
        for future in finished:
            job = running.pop(future)
            record = _result(future, job)
            submit()
            yield job, record


def _result(future: Any, job: ScanJob) -> SessionRecord:
    from distributed import KilledWorker

    try:
        return future.result()
    except KilledWorker:
        return lost_record(job, "its dask worker was lost again and again")
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
