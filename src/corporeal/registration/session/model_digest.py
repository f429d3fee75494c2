"""A hash of a model's content, whatever file it came from."""

from __future__ import annotations

import hashlib

import numpy as np

from corporeal.model.formats.core_arrays import core_keys
from corporeal.model.formats.native import native_keys
from corporeal.model.formats.official import statistics_keys
from corporeal.model.surface_model import SurfaceModel


def model_digest(model: SurfaceModel) -> str:
    """SHA-256 of all that a model's file would hold; the same model read from two layouts has one digest."""
    arrays = core_keys(model, "float64") | statistics_keys(model) | native_keys(model)
    content = hashlib.sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        content.update(f"{name} {array.dtype.str} {array.shape}\n".encode())
        content.update(array.tobytes())
    return content.hexdigest()
