"""Two runs never write to one folder of results."""

import signal
import subprocess
import sys

import pytest

from corporeal.registration.session.files import SessionFolderError
from corporeal.registration.session.lock import folder_lock

HOLDER = """
import sys, time
from corporeal.registration.session.lock import folder_lock
with folder_lock(sys.argv[1]):
    print("held", flush=True)
    time.sleep(60)
"""


def test_a_second_run_is_refused_until_the_first_has_ended(tmp_path):
    with folder_lock(tmp_path / "reg"):
        refused = pytest.raises(SessionFolderError, match="another run is writing to it")
        with refused, folder_lock(tmp_path / "reg"):
            pass
        with folder_lock(tmp_path / "other"):
            pass
    with folder_lock(tmp_path / "reg"):
        pass


def test_an_error_inside_gives_the_folder_back(tmp_path):
    with pytest.raises(KeyError), folder_lock(tmp_path):
        raise KeyError
    with folder_lock(tmp_path):
        pass


def test_a_killed_run_leaves_no_lock(tmp_path):
    process = subprocess.Popen([sys.executable, "-c", HOLDER, tmp_path], stdout=subprocess.PIPE)
    try:
        assert process.stdout.readline() == b"held\n"
        with pytest.raises(SessionFolderError), folder_lock(tmp_path):
            pass
    finally:
        process.send_signal(signal.SIGKILL)
        process.communicate()
    with folder_lock(tmp_path):
        pass
