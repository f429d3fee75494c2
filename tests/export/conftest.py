import json
import os
import runpy
import shutil
import subprocess
from pathlib import Path

import pytest

HERE = Path(__file__).parent
SYNTHETIC = runpy.run_path(str(HERE.parent / "synthetic.py"))


@pytest.fixture
def model(rng):
    return SYNTHETIC["random_model"](rng)


@pytest.fixture
def dense_model(rng):
    """Every vertex hangs on all five joints: more than the four of one set."""
    return SYNTHETIC["random_model"](rng, dense_weights=True)


def _node_modules(workspace: Path) -> Path:
    """A folder that holds the Khronos validator; made by npm where there is none."""
    given = os.environ.get("CORPOREAL_NODE_MODULES")
    for folder in [Path(given)] if given else [HERE / "node_modules"]:
        if (folder / "gltf-validator").is_dir():
            return folder
    if shutil.which("npm") is None:
        pytest.skip("glTF validation needs npm (or CORPOREAL_NODE_MODULES): the Khronos validator is absent")
    shutil.copy(HERE / "package.json", workspace)
    command = ["npm", "install", "--no-audit", "--no-fund", "--loglevel=error"]
    done = subprocess.run(command, cwd=workspace, capture_output=True, text=True, timeout=120, check=False)
    if done.returncode != 0:
        pytest.skip(f"npm could not fetch the Khronos glTF validator: {done.stderr.strip()[-300:]}")
    return workspace / "node_modules"


@pytest.fixture(scope="session")
def khronos_validator(tmp_path_factory):
    """A function that gives the Khronos validator's report on a file."""
    if shutil.which("node") is None:
        pytest.skip("glTF validation needs node, which is absent")
    modules = _node_modules(tmp_path_factory.mktemp("npm"))

    def validate(path: Path) -> dict:
        command = ["node", str(HERE / "validate.mjs"), str(modules), str(path)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout)

    return validate
