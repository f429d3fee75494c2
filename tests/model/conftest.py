"""The makers of official files, for the tests of this folder."""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest


@pytest.fixture(scope="session")
def official() -> ModuleType:
    """The module ``official_layouts`` beside this file."""
    path = Path(__file__).with_name("official_layouts.py")
    spec = importlib.util.spec_from_file_location("official_layouts", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module
