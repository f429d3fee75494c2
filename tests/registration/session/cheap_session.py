"""A session whose scans cost next to nothing, run as a program of its own so that it can be killed.

    python cheap_session.py SESSION REG WORKERS [local-pool|dask] [ROUNDS] [MILLISECONDS] [LONGEST]

A scan's file decides what happens: "kill" ends the worker at every try, "kill-once PATH" only where PATH
does not exist yet, "hang" never ends; the registration of any other is a cloud of points made from its
content.
"""

import hashlib
import os
import signal
import sys
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from corporeal.registration.rows import failed_row
from corporeal.registration.session.files import SessionFolderError, sha256_of
from corporeal.registration.session.jobs import WorkerError
from corporeal.registration.session.pool import run_local
from corporeal.registration.session.records import SessionRecord
from corporeal.registration.session.run import SessionPlan, Watcher, register_session
from corporeal.scans.formats.session import read_session


class CheapWorker:
    def __init__(self, pause):
        self.pause = pause

    def close(self):
        pass

    def __call__(self, job):
        begun = time.perf_counter()
        time.sleep(self.pause)
        sha256 = sha256_of(job.path)
        if sha256 is None:
            return SessionRecord(job.completed(failed_row(job.path, "cannot be read", {}, []), None))
        words = Path(job.path).read_text().split()
        if words[0] == "hang":
            time.sleep(3600)
        if words[0] == "kill" or (words[0] == "kill-once" and not Path(words[1]).exists()):
            if words[0] == "kill-once":
                Path(words[1]).touch()
            os.kill(os.getpid(), signal.SIGKILL)
        rng = np.random.default_rng(list(hashlib.sha256(words[0].encode()).digest()))
        pose = 0.1 * rng.standard_normal((16, 3))
        if job.prior is not None:
            pose[1:] += job.prior.for_side(job.side).pose[1:]
        row = failed_row(job.path, "fine", {"total": time.perf_counter() - begun}, [])
        row |= {"status": "ok" if rng.random() > 0.2 else "doubtful", "side": job.side}
        vertices = rng.uniform(-0.1, 0.1, (50, 3)) + pose[1]
        return SessionRecord(
            job.completed(row, sha256), vertices, pose, rng.standard_normal(10), pose[2], job.side
        )


@dataclass(frozen=True)
class CheapSetup:
    pause: float = 0.0

    def start(self):
        return CheapWorker(self.pause)


class Speaker(Watcher):
    def note(self, sentence):
        print("note:", sentence, flush=True)

    def advance(self, row):
        print("done:", row["name"], flush=True)


def main(session, folder, workers="2", where="local-pool", rounds="1", pause="0", longest="60"):
    if where == "local-pool":
        execute = partial(run_local, workers=int(workers), longest=float(longest))
    else:
        from corporeal.registration.session.cluster import run_dask

        execute = partial(run_dask, address="local", workers=int(workers))
    plan = SessionPlan(
        session=read_session(Path(session), (".txt",)),
        folder=Path(folder),
        setup=CheapSetup(1e-3 * float(pause)),
        description={"model": {"name": "cheap", "sha256": "0"}, "options": {"weight": 1.0}},
        execute=execute,
        rounds=int(rounds),
        watcher=Speaker(),
    )
    try:
        register_session(plan)
    except (SessionFolderError, WorkerError) as error:
        print("error:", error)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
