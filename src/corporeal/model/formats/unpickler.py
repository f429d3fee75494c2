"""Reads pickles as plain data: nothing that a file asks for is imported or called.

Research models are pickles of numpy arrays, scipy matrices and chumpy arrays. Instead of building those
objects, every permitted global becomes a ``Permitted`` marker and every call on it a ``Record`` of its
arguments; ``plain_arrays`` then turns the records that are needed into arrays. Hostile files therefore have
nothing to drive: no numpy constructor, no ``__setstate__``, no attribute of any real class.

The pure Python unpickler is used because the C one allocates a memo as large as a file claims.
"""

from __future__ import annotations

import io
import pickle
import pickletools
import struct
from collections.abc import Callable
from typing import Any

# Official files need some thousands. Three million took 16 s where each opened a list: as good as a hang.
OPCODE_LIMIT = 200_000


class RefusedPickleError(pickle.UnpicklingError):
    """The pickle asks for something that is not on the list of plain data."""


class Permitted:
    """The marker of a permitted global; ``kind`` is our own name for it."""

    __slots__ = ("kind",)

    def __init__(self, kind: str) -> None:
        self.kind = kind


class Record:
    """An object that the pickle describes: its kind, constructor arguments and state, all plain data."""

    __slots__ = ("arguments", "kind", "state")

    def __init__(self, kind: str, arguments: tuple) -> None:
        self.kind = kind
        self.arguments = arguments
        self.state: Any = None


def _permitted_globals() -> dict[tuple[str, str], str]:
    table = {
        ("numpy", "ndarray"): "ndarray class",
        ("numpy", "dtype"): "dtype",
        ("_codecs", "encode"): "latin1",
        ("collections", "OrderedDict"): "dict",
        ("chumpy.ch", "Ch"): "chumpy",
        ("chumpy.reordering", "Select"): "chumpy select",
        ("chumpy.reordering", "Reshape"): "chumpy reshape",
        ("chumpy.reordering", "transpose"): "chumpy transpose",
    }
    for core in ("numpy.core", "numpy._core"):
        table[f"{core}.multiarray", "_reconstruct"] = "ndarray"
        table[f"{core}.multiarray", "scalar"] = "scalar"
        table[f"{core}.numeric", "_frombuffer"] = "frombuffer"
    for module in ("copy_reg", "copyreg"):
        table[module, "_reconstructor"] = "reconstructor"
    for module in ("__builtin__", "builtins"):
        table[module, "object"] = "object class"
        table[module, "set"] = table[module, "frozenset"] = "set"
        table[module, "bytes"] = "empty bytes"
    for layout in ("csc", "csr", "coo"):
        for module in (f"scipy.sparse.{layout}", f"scipy.sparse._{layout}"):
            table[module, f"{layout}_matrix"] = table[module, f"{layout}_array"] = layout
    return table


PERMITTED = _permitted_globals()
_RECONSTRUCTIBLE = {"chumpy", "chumpy select", "chumpy reshape", "chumpy transpose", "csc", "csr", "coo"}
_CALLABLE = _RECONSTRUCTIBLE | {"ndarray", "scalar", "frombuffer", "dtype", "latin1", "set"}

# Left out: persistent ids, extension codes, old-style instances, keyword construction, outside buffers.
# fmt: off
_PLAIN_OPCODES = (
    "PROTO", "FRAME", "STOP", "MARK", "POP", "POP_MARK", "DUP", "NONE", "NEWTRUE", "NEWFALSE", "INT",
    "BININT", "BININT1", "BININT2", "LONG", "LONG1", "LONG4", "FLOAT", "BINFLOAT", "STRING", "BINSTRING",
    "SHORT_BINSTRING", "BINBYTES", "SHORT_BINBYTES", "BINBYTES8", "UNICODE", "BINUNICODE",
    "SHORT_BINUNICODE", "BINUNICODE8", "EMPTY_TUPLE", "TUPLE", "TUPLE1", "TUPLE2", "TUPLE3", "EMPTY_LIST",
    "LIST", "APPEND", "APPENDS", "EMPTY_DICT", "GET", "BINGET", "LONG_BINGET", "PUT", "BINPUT", "LONG_BINPUT",
    "MEMOIZE", "GLOBAL", "STACK_GLOBAL",
)
# fmt: on


class _Reader(pickle._Unpickler):
    """The pure Python unpickler with every opcode that could run something replaced by its record."""

    stack: list
    append: Callable[[Any], None]
    read: Callable[[int], bytes]
    copies_left = OPCODE_LIMIT
    pop_mark: Callable[[], list]

    def find_class(self, module: str, name: str) -> Permitted:
        """The marker of a permitted global; everything else is refused, and nothing is imported."""
        kind = PERMITTED.get((module, name))
        if kind is None:
            raise RefusedPickleError(
                f"it asks for {module}.{name}, which is not among the plain data that are read; "
                "nothing was run"
            )
        return Permitted(kind)

    def record_call(self) -> None:
        """REDUCE and NEWOBJ: note the call instead of making it."""
        arguments = self.stack.pop()
        target = self.stack.pop()
        if not isinstance(target, Permitted) or not isinstance(arguments, tuple):
            raise RefusedPickleError("it calls something that is no permitted constructor; nothing was run")
        if target.kind == "dict":
            self.append(self.copied_pairs(arguments))
        else:
            self.append(_record(target.kind, arguments))

    def copied_pairs(self, arguments: tuple) -> dict:
        """OrderedDict of a list of pairs. One list may be copied again and again: copies are counted."""
        pairs: dict = {}
        for pair in arguments[0] if arguments else ():
            self.copies_left -= 1
            if self.copies_left < 0 or len(pair) != 2:
                raise RefusedPickleError("it fills dictionaries with more than any model needs")
            _set_pairs(pairs, list(pair))
        return pairs

    def record_state(self) -> None:
        """BUILD: keep the state beside the record instead of setting attributes."""
        state = self.stack.pop()
        if not isinstance(self.stack[-1], Record):
            raise RefusedPickleError("it sets the state of something that is no record; nothing was run")
        self.stack[-1].state = state

    def collect_pairs(self) -> None:
        """SETITEMS."""
        items = self.pop_mark()
        _set_pairs(self.stack[-1], items)

    def collect_pair(self) -> None:
        """SETITEM."""
        value, key = self.stack.pop(), self.stack.pop()
        _set_pairs(self.stack[-1], [key, value])

    def collect_dict(self) -> None:
        """DICT."""
        pairs: dict = {}
        _set_pairs(pairs, self.pop_mark())
        self.append(pairs)

    def read_bytearray(self) -> None:
        """BYTEARRAY8 without room made for the claimed length."""
        (length,) = struct.unpack("<Q", self.read(8))
        self.append(self.read(length))

    def empty_set(self) -> None:
        """EMPTY_SET: a list, since members are never hashed."""
        self.append([])

    def frozen_set(self) -> None:
        """FROZENSET: a list as well."""
        self.append(self.pop_mark())


def _record(kind: str, arguments: tuple) -> Record | bytes:
    if kind == "empty bytes" and not arguments:
        return b""
    if kind == "reconstructor":
        cls, base = arguments[0], arguments[1]
        fits = isinstance(cls, Permitted) and isinstance(base, Permitted) and base.kind == "object class"
        if not fits or cls.kind not in _RECONSTRUCTIBLE:
            raise RefusedPickleError("it rebuilds an object that is no permitted array; nothing was run")
        return Record(cls.kind, ())
    if kind not in _CALLABLE:
        raise RefusedPickleError(f"it calls the {kind}, which is not permitted; nothing was run")
    if kind == "scalar" and _is_object_dtype(arguments[0]):
        raise RefusedPickleError("it holds a numpy scalar that is a Python object; nothing was run")
    return Record(kind, arguments)


def _is_object_dtype(dtype: Any) -> bool:
    return not (isinstance(dtype, Record) and dtype.kind == "dtype") or str(dtype.arguments[0]).startswith(
        "O"
    )


def _set_pairs(target: Any, items: list) -> None:
    if type(target) is not dict:
        raise RefusedPickleError("it sets items of something that is no dictionary; nothing was run")
    for i in range(0, len(items), 2):
        key = items[i]
        # Nested tuples would be hashed in exponential time, and giant numbers again and again.
        if not (isinstance(key, (str, bytes)) or (isinstance(key, int) and abs(key) < 2**63)):
            raise RefusedPickleError("it has dictionary keys that are neither text nor short numbers")
        target[key] = items[i + 1]


def _handlers() -> dict[int, Callable[[_Reader], None]]:
    inherited = pickle._Unpickler.dispatch
    table: dict[int, Callable] = {
        getattr(pickle, name)[0]: inherited[getattr(pickle, name)[0]] for name in _PLAIN_OPCODES
    }
    table[pickle.REDUCE[0]] = table[pickle.NEWOBJ[0]] = _Reader.record_call
    table[pickle.BUILD[0]] = _Reader.record_state
    table[pickle.SETITEM[0]] = _Reader.collect_pair
    table[pickle.SETITEMS[0]] = _Reader.collect_pairs
    table[pickle.DICT[0]] = _Reader.collect_dict
    table[pickle.BYTEARRAY8[0]] = _Reader.read_bytearray
    table[pickle.EMPTY_SET[0]] = _Reader.empty_set
    table[pickle.ADDITEMS[0]] = inherited[pickle.APPENDS[0]]
    table[pickle.FROZENSET[0]] = _Reader.frozen_set
    return table


_HANDLERS = _handlers()
_OPCODE_NAMES = {ord(opcode.code): opcode.name for opcode in pickletools.opcodes}


class _Budget:
    """The opcode table of one reading: counts, and refuses what it does not hold."""

    def __init__(self) -> None:
        self._left = OPCODE_LIMIT

    def __getitem__(self, code: int) -> Callable[[_Reader], None]:
        self._left -= 1
        if self._left < 0:
            raise RefusedPickleError(f"it has more than {OPCODE_LIMIT} steps, which no model needs")
        handler = _HANDLERS.get(code)
        if handler is None:
            label = _OPCODE_NAMES.get(code, f"0x{code:02x}")
            raise RefusedPickleError(
                f"it uses the step {label}, which plain data do not need; nothing was run"
            )
        return handler


def read_pickle(content: bytes) -> Any:
    """Read one pickle into dicts, lists, tuples, texts, numbers and ``Record`` objects.

    Text of Python 2 is decoded as Latin-1, so that every byte survives.

    Raises:
        RefusedPickleError: a global, a call or an opcode that is not on the list.
        Exception: bytes that are no pickle raise whatever the parser meets first.
    """
    reader = _Reader(io.BytesIO(content), encoding="latin1")
    reader.dispatch = _Budget()  # type: ignore[assignment]
    return reader.load()
