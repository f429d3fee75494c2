"""Our worker inside a dask worker; imported only where dask is."""

from __future__ import annotations

import threading
from typing import Any

from distributed import WorkerPlugin, get_worker

from corporeal.registration.session.jobs import AnySetup, NamedJob, TellingWorker

NAME = "corporeal-session"


class SessionWorkerPlugin(WorkerPlugin):
    """Holds the setup, sent once to every dask worker, and what it starts there at the first scan."""

    def __init__(self, setup: AnySetup, topic: str) -> None:
        self.name = NAME
        self._setup = setup
        self._topic = topic
        self._worker: Any = None

    def setup(self, worker: Any) -> None:
        """Called by dask: a lock cannot be sent, so it is made here."""
        # The detector and numba's workspaces are one scan's at a time, whatever the threads of the worker.
        self._lock = threading.Lock()

    def teardown(self, worker: Any) -> None:
        """Called by dask when the worker ends."""
        if self._worker is not None:
            self._worker.close()
            self._worker = None

    def run(self, job: NamedJob) -> Any:
        """Do one job; its news go to the topic as (name of the job, content)."""
        with self._lock:
            if self._worker is None:
                self._worker = self._setup.start()
            if isinstance(self._worker, TellingWorker):
                dask = get_worker()
                self._worker.tell = lambda content: dask.log_event(self._topic, (job.name, content))
            return self._worker(job)


def run_on_worker(job: NamedJob) -> Any:
    """The task."""
    plugin: Any = get_worker().plugins[NAME]
    return plugin.run(job)
