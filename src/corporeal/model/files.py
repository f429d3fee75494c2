"""Model files: ours and the official ones of the SMPL family, in; ours and theirs, out."""

from __future__ import annotations

import io
from importlib import resources
from pathlib import Path
from typing import Literal

from corporeal.model.formats.archive import SIZE_LIMIT, write_archive
from corporeal.model.formats.containers import ArchiveSource
from corporeal.model.formats.core_arrays import Precision, core_keys
from corporeal.model.formats.errors import LeftHandWarning, ModelFileError, file_error
from corporeal.model.formats.native import is_native, native_keys, read_native
from corporeal.model.surface_model import Side, SurfaceModel

__all__ = ["LeftHandWarning", "ModelFileError", "load_model", "open_model", "save_model"]


def load_model(path: Path | str) -> SurfaceModel:
    path = Path(path)
    source = ArchiveSource(path.read_bytes())
    return read_native(source)


def save_model(model: SurfaceModel, path: Path | str, *, precision: Precision = "float64") -> None:
    path = Path(path)
    write_archive(path, core_keys(model, precision) | native_keys(model))


def open_model(name: str, side: Side = "right") -> SurfaceModel:
    file = resources.files("corporeal.model") / "open_models" / f"{name}.npz"
    with resources.as_file(file) as path:
        model = load_model(path)
    if model.side is None or model.side == side:
        return model
    from corporeal.model.mirror import mirror_model

    return mirror_model(model)
