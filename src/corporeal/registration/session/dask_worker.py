"""Our worker inside a dask worker; imported only where dask is."""

from __future__ import annotations

import threading
from typing import Any

from distributed import WorkerPlugin, get_worker

from corporeal.registration.session.jobs import ScanJob, Worker, WorkerSetup
from corporeal.registration.session.records import SessionRecord

NAME = "corporeal-session"


class SessionWorkerPlugin(WorkerPlugin):
    """Holds the setup, sent once to every dask worker, and what it starts there at the first scan."""

    def __init__(self, setup: WorkerSetup) -> None:
        self.name = NAME
        self._setup = setup
        self._worker: Worker | None = None

    def setup(self, worker: Any) -> None:
        """Called by dask: a lock cannot be sent, so it is made here."""
        # The detector and numba's workspaces are one scan's at a time, whatever the threads of the worker.
        self._lock = threading.Lock()

    def teardown(self, worker: Any) -> None:
        """Called by dask when the worker ends."""
        if self._worker is not None:
            self._worker.close()
            self._worker = None

    def run(self, job: ScanJob) -> SessionRecord:
        """Register one scan."""
        with self._lock:
            if self._worker is None:
                self._worker = self._setup.start()
            return self._worker(job)


def register_on_worker(job: ScanJob) -> SessionRecord:
    """The task."""
    plugin: Any = get_worker().plugins[NAME]
    return plugin.run(job)
