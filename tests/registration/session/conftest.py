"""A session whose scans cost next to nothing, and ways to run it."""

import importlib.util
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from corporeal.registration.session.files import read_records

PROGRAM = Path(__file__).with_name("cheap_session.py")


@pytest.fixture(scope="session")
def cheap():
    """The program as a module."""
    spec = importlib.util.spec_from_file_location("cheap_session", PROGRAM)
    module = importlib.util.module_from_spec(spec)
    # Dataclasses look their module up.
    sys.modules["cheap_session"] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def make_session(tmp_path):
    def make(count=24, poses=3):
        folder = tmp_path / "session"
        folder.mkdir()
        scans = []
        for number in range(count):
            side = ("left", "right")[number % 2]
            name = f"s{number:02}"
            (folder / f"{name}.txt").write_text(f"content-{number}")
            pose = f"p{number % poses}"
            scans.append(
                {
                    "name": name,
                    "file": f"{name}.txt",
                    "subject": f"u{number // 6}",
                    "protocol_pose": pose,
                    "side": side,
                }
            )
        write_list(folder, scans)
        return folder

    return make


def write_list(folder, scans):
    content = {"format": "corporeal-session-1", "unit": "mm", "scans": scans}
    (folder / "session.json").write_text(json.dumps(content))


@pytest.fixture(scope="session")
def start():
    """Start the program; its workers share its output, which ends when the last of them has ended."""

    def run(*arguments):
        command = [sys.executable, str(PROGRAM), *map(str, arguments)]
        return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)

    return run


@pytest.fixture(scope="session")
def finish(start):
    """Run the program to its end; its exit status and what it said."""

    def run(*arguments):
        process = start(*arguments)
        said, _ = process.communicate(timeout=120)
        return process.returncode, said

    return run


@pytest.fixture(scope="session")
def results():
    """All that a session left, without times, as bytes."""

    def read(folder):
        found = {}
        for record in read_records(folder):
            row = {key: value for key, value in record.row.items() if key != "seconds"}
            arrays = [record.vertices, record.pose, record.shape, record.translation]
            found[record.name] = (
                json.dumps(row, sort_keys=True),
                record.side,
                *(None if array is None else np.asarray(array).tobytes() for array in arrays),
            )
        items = json.loads((folder / "session.json").read_text())["items"]
        assert [item["name"] for item in items] == sorted(found)
        stripped = [{key: value for key, value in item.items() if key != "seconds"} for item in items]
        return found, json.dumps(stripped, sort_keys=True)

    return read
