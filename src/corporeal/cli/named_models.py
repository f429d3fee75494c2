"""Models as the command line names them."""

from __future__ import annotations

from pathlib import Path

from corporeal.model.files import ModelFileError, load_model, open_model
from corporeal.model.surface_model import SurfaceModel


def named_model(name: Path) -> SurfaceModel:
    """A model file, or a model in the box where no file of that name is there.

    Raises:
        ModelFileError: it is neither, or the file cannot be read.
    """
    if name.suffix or name.is_file():
        return load_model(name)
    try:
        return open_model(str(name))
    except ModelFileError:
        if name.exists():
            return load_model(name)
        raise
