"""One run at a time writes to a folder of results."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from corporeal.registration.session.files import SessionFolderError, make_folder

LOCK = ".lock"


@contextmanager
def folder_lock(folder: Path | str) -> Iterator[None]:
    """Hold a folder of results until the block ends, however it ends.

    The kernel holds the lock for the process: kill -9 or a power cut leave none behind, as a file with a
    process number in it would. Between machines that share a folder it holds as far as their file system
    passes it on.

    Raises:
        SessionFolderError: another run holds the folder.
        OSError: the folder cannot be written.
    """
    try:
        import fcntl
    except ImportError:  # no such locks on this system
        make_folder(folder)
        yield
        return
    make_folder(folder)
    descriptor = os.open(Path(folder) / LOCK, os.O_RDWR | os.O_CREAT, 0o644)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise SessionFolderError(
                f"{folder}: another run is writing to it; wait for its end, or give another folder"
            ) from error
        yield
    finally:
        os.close(descriptor)
