"""Checked reading of named arrays, whatever container they come from."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import numpy as np
import scipy.sparse as sp

# None stands for any length.
Shape = Sequence[int | None]


@runtime_checkable
class Source(Protocol):
    """A container of named values, read one by one."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of what it holds."""
        ...

    def value(self, key: str) -> np.ndarray | sp.spmatrix:
        """One value as an array or sparse matrix; ``ValueError`` where it is neither."""
        ...


def numbers(source: Source, key: str, shape: Shape) -> np.ndarray:
    """A dense array of finite numbers in float64, of the given shape.

    Raises:
        ValueError: the key is missing, the values are no numbers or not finite, or the shape is another.
    """
    value = _present(source, key)
    if sp.issparse(value):
        raise ValueError(f"{key!r} is a sparse matrix, expected a dense array")
    _check_shape(key, value.shape, shape)
    return _finite(key, value)


def indices(source: Source, key: str, shape: Shape, upper: int, lower: int = 0) -> np.ndarray:
    """An array of integers in ``lower .. upper - 1`` as int64; floats that are whole numbers are taken too.

    Raises:
        ValueError: as ``numbers``, or an entry is no whole number or out of range.
    """
    value = _present(source, key)
    if sp.issparse(value):
        raise ValueError(f"{key!r} is a sparse matrix, expected a dense array")
    _check_shape(key, value.shape, shape)
    if value.dtype.kind not in "iu":
        value = _finite(key, value)
        if np.any(value != np.round(value)):
            raise ValueError(f"{key!r} holds fractions, expected indices")
    if value.size and (value.min() < lower or value.max() >= upper):
        raise ValueError(
            f"{key!r} holds {value.min()} .. {value.max()}, expected indices in {lower} .. {upper - 1}"
        )
    return np.array(value, dtype=np.int64, order="C")


def sparse_numbers(source: Source, key: str, shape: tuple[int, int]) -> sp.csr_matrix:
    """A matrix of finite numbers, dense or sparse in the file, as CSR without stored zeros.

    Raises:
        ValueError: as ``numbers``.
    """
    value = _present(source, key)
    _check_shape(key, value.shape, shape)
    if not sp.issparse(value):
        return sp.csr_matrix(_finite(key, value))
    matrix = sp.csr_matrix(value)
    matrix = sp.csr_matrix((_finite(key, matrix.data), matrix.indices, matrix.indptr), shape=shape)
    matrix.sum_duplicates()
    matrix.eliminate_zeros()
    return matrix


def text(source: Source, key: str) -> str:
    """A single text.

    Raises:
        ValueError: the key is missing or holds no text.
    """
    value = _present(source, key)
    if sp.issparse(value) or value.dtype.kind != "U" or value.shape != ():
        raise ValueError(f"{key!r} holds no text")
    return str(value[()])


def _present(source: Source, key: str) -> np.ndarray | sp.spmatrix:
    if key not in source.names:
        held = ", ".join(sorted(source.names)[:40]) or "nothing"
        raise ValueError(f"{key!r} is missing (the file holds: {held})")
    return source.value(key)


def _check_shape(key: str, got: tuple[int, ...], wanted: Shape) -> None:
    matches = len(got) == len(wanted) and all(w is None or g == w for g, w in zip(got, wanted, strict=True))
    if not matches:
        words = " x ".join("any" if length is None else str(length) for length in wanted)
        raise ValueError(f"{key!r} has shape {tuple(got)}, expected {words}")


def _finite(key: str, value: np.ndarray) -> np.ndarray:
    if value.dtype.kind not in "fiub":
        raise ValueError(f"{key!r} has type {value.dtype}, expected numbers")
    result = np.array(value, dtype=np.float64, order="C")
    if not np.isfinite(result).all():
        raise ValueError(f"{key!r} holds NaN or infinite numbers")
    return result
