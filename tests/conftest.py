"""Shape checks for the whole package, seeds, and the way to the real data.

jaxtyping's import hook wraps every function of a module; numba cannot compile a wrapped function. Kernels
therefore live in modules named ``*kernels.py`` and are left out here; their typed callers are checked.
"""

import os
import signal

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
# A shell's background job ignores Ctrl-C, and so would the commands that tests start and stop with it.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

from pathlib import Path

from jaxtyping import install_import_hook

REPOSITORY = Path(__file__).resolve().parents[1]
SOURCE = REPOSITORY / "src"


def _checked_modules() -> list[str]:
    modules = []
    for file in sorted((SOURCE / "corporeal").rglob("*.py")):
        if file.stem.endswith("kernels") or file.stem in {"__init__", "__main__"}:
            continue
        modules.append(".".join(file.relative_to(SOURCE).with_suffix("").parts))
    return modules


install_import_hook(_checked_modules(), "beartype.beartype")

import numpy as np
import pytest

SHARED_DATA = Path(os.environ.get("CORPOREAL_DATA", REPOSITORY.parent / "shared" / "data"))


@pytest.fixture
def rng() -> np.random.Generator:
    """A generator with a fixed seed: every run sees the same numbers."""
    return np.random.default_rng(20171)


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of real scans; the test is skipped, saying so, where it is absent."""
    if not SHARED_DATA.is_dir():
        pytest.skip(f"real data not found at {SHARED_DATA} (set CORPOREAL_DATA to its folder)")
    return SHARED_DATA
