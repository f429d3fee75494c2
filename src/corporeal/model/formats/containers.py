"""The two containers as sources of named values."""

from __future__ import annotations

import pickle
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp

from corporeal.atomic import write_bytes
from corporeal.model.formats.archive import Archive, array_of_member
from corporeal.model.formats.fields import Source
from corporeal.model.formats.plain_arrays import array_of
from corporeal.model.formats.unpickler import read_pickle

_ZIP_START = b"PK"


class ArchiveSource:
    """An ``.npz`` file in memory; members that hold a pickled object are read as plain data."""

    def __init__(self, content: bytes) -> None:
        self._archive = Archive(content)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the arrays."""
        return self._archive.names

    def value(self, key: str) -> np.ndarray | sp.spmatrix:
        """One array."""
        array = array_of_member(self._archive.member(key))
        return array_of(read_pickle(array)) if isinstance(array, bytes) else array


class PickleSource:
    """A pickled dictionary in memory; only what is asked for is turned into arrays."""

    def __init__(self, content: bytes) -> None:
        values = read_pickle(content)
        if not isinstance(values, dict):
            raise ValueError(f"the pickle holds a {type(values).__name__}, expected a dictionary of arrays")
        self._values: dict[str, Any] = {key: value for key, value in values.items() if isinstance(key, str)}

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the values."""
        return tuple(self._values)

    def value(self, key: str) -> np.ndarray | sp.spmatrix:
        """One array or matrix."""
        return array_of(self._values[key])


def source_of(content: bytes) -> Source:
    """The container, told from its first bytes and not from the file's name."""
    return ArchiveSource(content) if content.startswith(_ZIP_START) else PickleSource(content)


def write_pickle(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Write a pickled dictionary of plain numpy arrays, which smplx reads without chumpy."""
    plain = {key: np.array(arrays[key], order="C") for key in sorted(arrays)}
    write_bytes(path, pickle.dumps(plain, protocol=4))
