"""The two containers as sources of named values."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from corporeal.model.formats.archive import Archive, array_of_member


class ArchiveSource:
    """An ``.npz`` file in memory."""

    def __init__(self, content: bytes) -> None:
        self._archive = Archive(content)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the arrays."""
        return self._archive.names

    def value(self, key: str) -> np.ndarray | sp.spmatrix:
        """One array."""
        array = array_of_member(self._archive.member(key))
        if isinstance(array, bytes):
            raise ValueError(f"{key!r} holds Python objects, expected numbers")
        return array
