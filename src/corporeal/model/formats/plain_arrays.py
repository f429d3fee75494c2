"""Turns the records of a pickle into arrays, checking every size against the data that are really there."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.sparse as sp

from corporeal.model.formats.unpickler import Record

# Research files need three levels: a selection from a chumpy array of an array. Every level may refer to the
# one below more than once, so that the work grows exponentially with them.
_NESTING_LIMIT = 5
_PLAIN_DTYPE = re.compile(r"\?|[biufSU][0-9]{1,9}")


def array_of(value: Any, depth: int = 0) -> np.ndarray | sp.spmatrix:
    """The array or sparse matrix that a value read by ``read_pickle`` stands for.

    chumpy arrays give their values. A single object wrapped into a numpy array (what ``np.savez`` makes of a
    sparse matrix) is unwrapped.

    Raises:
        ValueError: the value is no array of plain numbers or text, or its parts do not fit together.
    """
    if depth > _NESTING_LIMIT:
        raise ValueError(f"arrays are nested more than {_NESTING_LIMIT} deep")
    if isinstance(value, (bool, int, float, str)):
        return np.array(value)
    builder = _BUILDERS.get(value.kind) if isinstance(value, Record) else None
    if builder is None:
        label = value.kind if isinstance(value, Record) else type(value).__name__
        raise ValueError(f"found a {label} where an array was expected")
    return builder(value, depth + 1)


def _ndarray(record: Record, depth: int) -> np.ndarray | sp.spmatrix:
    state = record.state
    if not isinstance(state, tuple) or len(state) not in (4, 5):
        raise ValueError("an array has no state")
    shape, dtype, fortran_order, data = state[-4:]
    if _dtype_code(dtype).startswith("O"):
        if shape == () and isinstance(data, list) and len(data) == 1:
            return array_of(data[0], depth)
        raise ValueError("found an array of Python objects, expected numbers")
    return _filled(shape, _dtype(dtype), data, bool(fortran_order))


def _frombuffer(record: Record, depth: int) -> np.ndarray:
    data, dtype, shape, order = record.arguments
    return _filled(shape, _dtype(dtype), data, order == "F")


def _scalar(record: Record, depth: int) -> np.ndarray:
    dtype, data = record.arguments
    return _filled((), _dtype(dtype), data, False)


def _csc(record: Record, depth: int) -> sp.csc_matrix:
    return sp.csc_matrix(_compressed_parts(record, depth, axis=1), shape=_matrix_shape(record))


def _csr(record: Record, depth: int) -> sp.csr_matrix:
    return sp.csr_matrix(_compressed_parts(record, depth, axis=0), shape=_matrix_shape(record))


def _coo(record: Record, depth: int) -> sp.coo_matrix:
    shape = _matrix_shape(record)
    rows, columns = _attribute(record, "coords", "row"), _attribute(record, "coords", "col")
    if isinstance(rows, tuple):
        rows, columns = rows
    values = _vector(_attribute(record, "data"), depth)
    row_indices = _bounded(_vector(rows, depth), shape[0])
    column_indices = _bounded(_vector(columns, depth), shape[1])
    if not len(values) == len(row_indices) == len(column_indices):
        raise ValueError("a sparse matrix has parts of different lengths")
    return sp.coo_matrix((values, (row_indices, column_indices)), shape=shape)


def _compressed_parts(record: Record, depth: int, axis: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    shape = _matrix_shape(record)
    data = _vector(_attribute(record, "data"), depth)
    minor = _bounded(_vector(_attribute(record, "indices"), depth), shape[1 - axis])
    ends = _bounded(_vector(_attribute(record, "indptr"), depth), len(data) + 1)
    # scipy trusts these; out of range they make it read foreign memory.
    if len(ends) != shape[axis] + 1 or ends[0] != 0 or ends[-1] != len(data) or np.any(np.diff(ends) < 0):
        raise ValueError("a sparse matrix has pointers that do not fit its data")
    if len(minor) != len(data):
        raise ValueError("a sparse matrix has parts of different lengths")
    return data, minor, ends


def _chumpy(record: Record, depth: int) -> np.ndarray | sp.spmatrix:
    return array_of(_attribute(record, "x"), depth)


def _select(record: Record, depth: int) -> np.ndarray:
    values = _dense(_attribute(record, "a"), depth).ravel()
    chosen = _bounded(_vector(_attribute(record, "idxs"), depth), len(values))
    result = values[chosen]
    if isinstance(record.state, dict) and "preferred_shape" in record.state:
        return result.reshape(_target_shape(record.state["preferred_shape"], depth))
    return result


def _reshape(record: Record, depth: int) -> np.ndarray:
    shape = _target_shape(_attribute(record, "newshape"), depth)
    return _dense(_attribute(record, "a"), depth).reshape(shape)


def _transpose(record: Record, depth: int) -> np.ndarray:
    axes = record.state.get("axes") if isinstance(record.state, dict) else None
    array = _dense(_attribute(record, "a"), depth)
    return np.transpose(array, None if axes is None else _target_shape(axes, depth))


_BUILDERS: dict[str, Callable[[Record, int], np.ndarray | sp.spmatrix]] = {
    "ndarray": _ndarray,
    "frombuffer": _frombuffer,
    "scalar": _scalar,
    "csc": _csc,
    "csr": _csr,
    "coo": _coo,
    "chumpy": _chumpy,
    "chumpy select": _select,
    "chumpy reshape": _reshape,
    "chumpy transpose": _transpose,
}


def _filled(shape: Any, dtype: np.dtype, data: Any, fortran_order: bool) -> np.ndarray:
    shape = _lengths(shape)
    content = _bytes_of(data)
    count = 1
    for length in shape:
        count *= length
    if min(shape, default=0) < 0 or count * dtype.itemsize != len(content) or dtype.itemsize == 0:
        raise ValueError(f"an array claims shape {shape} of {dtype}, but holds {len(content)} bytes")
    if count == 0:
        return np.zeros(shape, dtype)
    return np.frombuffer(content, dtype).reshape(shape, order="F" if fortran_order else "C")


def _bytes_of(data: Any) -> bytes | bytearray:
    if isinstance(data, Record) and data.kind == "latin1":
        data = data.arguments[0] if data.arguments[1:] == ("latin1",) else None
    if isinstance(data, str):
        return data.encode("latin1")
    if isinstance(data, (bytes, bytearray)):
        return data
    raise ValueError("an array has no data")


def _dtype_code(record: Any) -> str:
    if not isinstance(record, Record) or record.kind != "dtype" or not isinstance(record.arguments[0], str):
        raise ValueError("an array has no type")
    return record.arguments[0]


def _dtype(record: Any) -> np.dtype:
    code = _dtype_code(record)
    if not _PLAIN_DTYPE.fullmatch(code):
        raise ValueError("an array has a type that is neither numbers nor text")
    state = record.state
    order: Any = state[1] if isinstance(state, tuple) and len(state) > 1 else "="
    if order not in ("<", ">", "=", "|"):
        raise ValueError("an array has an unknown byte order")
    return np.dtype(code).newbyteorder(order)


def _attribute(record: Record, *names: str) -> Any:
    for name in names:
        if isinstance(record.state, dict) and name in record.state:
            return record.state[name]
    raise ValueError(f"a {record.kind} array lacks its {names[-1]!r}")


def _matrix_shape(record: Record) -> tuple[int, int]:
    shape = _lengths(_attribute(record, "_shape", "shape"))
    if len(shape) != 2 or min(shape) < 0 or max(shape) > 2**31:
        raise ValueError("a sparse matrix has no sensible shape")
    return shape[0], shape[1]


def _lengths(value: Any) -> tuple[int, ...]:
    """A shape from whole numbers only, plain or numpy's: a shape made of arrays could refer to itself."""
    entries = (value,) if isinstance(value, int) else value
    if not isinstance(entries, (tuple, list)) or len(entries) > 8:
        raise ValueError("a shape is no short list of numbers")
    lengths = [
        _scalar(entry, 0).item() if isinstance(entry, Record) and entry.kind == "scalar" else entry
        for entry in entries
    ]
    if any(type(length) is not int for length in lengths):
        raise ValueError("a shape holds something that is no whole number")
    return tuple(lengths)


def _target_shape(value: Any, depth: int) -> tuple[int, ...]:
    return _lengths(_vector(value, depth).tolist() if isinstance(value, Record) else value)


def _dense(value: Any, depth: int) -> np.ndarray:
    array = array_of(value, depth)
    if sp.issparse(array):
        raise ValueError("found a sparse matrix where a dense array was expected")
    return array


def _vector(value: Any, depth: int) -> np.ndarray:
    array = _dense(value, depth)
    if array.ndim != 1:
        raise ValueError(f"found an array of {array.ndim} dimensions where a list of numbers was expected")
    return array


def _bounded(array: np.ndarray, upper: int) -> np.ndarray:
    if array.dtype.kind not in "iu":
        raise ValueError("indices are no whole numbers")
    if array.size and (array.min() < 0 or array.max() >= upper):
        raise ValueError(f"indices are outside 0..{upper - 1}")
    return array.astype(np.int64)
