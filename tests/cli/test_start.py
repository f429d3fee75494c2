"""Help and version need no library that takes long to import."""

import subprocess
import sys

import pytest

_PROBE = """
import sys
from corporeal.cli.main import main
try:
    status = main(sys.argv[1:])
except SystemExit as error:
    status = error.code
slow = {"torch", "numba", "mediapipe", "scipy", "matplotlib", "trimesh"} & set(sys.modules)
sys.exit(f"imported {slow}" if slow else status)
"""


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--version"], "corporeal 0."),
        (["--help"], "simulate"),
        (["register", "--help"], "--green-objects"),
        (["convert", "--help"], "--repair-left"),
    ],
)
def test_nothing_slow_is_imported(arguments, words):
    command = [sys.executable, "-c", _PROBE, *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    assert words in done.stdout
