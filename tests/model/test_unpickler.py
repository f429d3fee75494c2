"""Hostile pickles are refused with nothing run; honest ones become plain data."""

import collections
import functools
import io
import os
import pickle
import struct
import sys
import time

import numpy as np
import pytest
import scipy.sparse as sp

from corporeal.model.formats.plain_arrays import array_of
from corporeal.model.formats.unpickler import PERMITTED, Permitted, Record, RefusedPickleError, read_pickle


class _Call:
    """Pickles as a call of ``function`` with ``arguments``."""

    def __init__(self, function, *arguments, state=None):
        self._reduced = (function, arguments, state) if state is not None else (function, arguments)

    def __reduce__(self):
        return self._reduced


def _protocol_zero(module, name, argument):
    return f"c{module}\n{name}\n(S'{argument}'\ntR.".encode()


def _hostile(marker):
    command = f"touch {marker}"
    return {
        "os.system": pickle.dumps(_Call(os.system, command)),
        "os.system, protocol 0": _protocol_zero("os", "system", command),
        "posix.system, protocol 0": _protocol_zero("posix", "system", command),
        "eval": pickle.dumps(_Call(eval, f"open({str(marker)!r}, 'w')")),
        "exec, python 2 name": _protocol_zero("__builtin__", "eval", f'open("{marker}", "w")'),
        "getattr": pickle.dumps(getattr),
        "numpy runstring": _protocol_zero("numpy.testing._private.utils", "runstring", command),
        "numpy load": pickle.dumps(_Call(np.load, str(marker))),
        "numpy f2py": _protocol_zero("numpy.f2py.diagnose", "run_command", command),
        "numpy dotted name": b"cnumpy\nf2py.os.system\n(S'" + command.encode() + b"'\ntR.",
        "array holding a call": pickle.dumps(np.array([_Call(os.system, command)], dtype=object)),
        "call inside a dict": pickle.dumps({"v_template": np.zeros(3), "extra": _Call(os.system, command)}),
        "call as array state": pickle.dumps(
            _Call(np.zeros(1).__reduce__()[0], np.ndarray, (0,), b"b", state=_Call(os.system, command))
        ),
        "functools.partial": pickle.dumps(_Call(functools.partial, os.system, command)),
        "old-style instance": f"(ios\nsystem\nS'{command}'\n.".encode(),
        "object construction": f"(cos\nsystem\nS'{command}'\no.".encode(),
        "persistent id": b"Pos.system\n.",
        "extension code": b"\x82\x01.",
        "new object with keywords": pickle.PROTO + b"\x04cnumpy\nndarray\n)}\x92.",
    }


HOSTILE = sorted(_hostile("x"))


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_pickles_are_refused_and_run_nothing(name, tmp_path):
    marker = tmp_path / "ran"
    with pytest.raises(RefusedPickleError):
        read_pickle(_hostile(marker)[name])
    assert not marker.exists()


def test_refusal_names_the_global():
    with pytest.raises(RefusedPickleError, match=r"posix\.system"):
        read_pickle(pickle.dumps(_Call(os.system, "true")))


def test_nothing_is_imported():
    module = "this"
    assert module not in sys.modules
    with pytest.raises(RefusedPickleError):
        read_pickle(f"c{module}\nd\n.".encode())
    assert module not in sys.modules


@pytest.mark.parametrize(
    "content",
    [
        pickle.dumps(_Call(np.zeros(1)[0].__reduce__()[0], np.dtype("O"), b"12345678")),
        # A permitted class rebuilt around something else, a state for a marker, a call of a call.
        b"ccopy_reg\n_reconstructor\n(cnumpy\nndarray\nc__builtin__\nobject\nNtR.",
        b"ccopy_reg\n_reconstructor\n(cchumpy.ch\nCh\ncnumpy\nndarray\nNtR.",
        b"cchumpy.ch\nCh\n(dS'x'\nI1\nsb.",
        b"cchumpy.ch\nCh\n(tR(tR.",
        b"c__builtin__\nobject\n(tR.",
        b"cnumpy\nndarray\n(I9\ntR.",
        b"c__builtin__\nbytes\n(I999999999999\ntR.",
        b"cchumpy.ch\nCh\n(tRS'key'\nI1\ns.",
    ],
)
def test_permitted_names_cannot_be_combined_into_something_else(content):
    with pytest.raises(RefusedPickleError):
        read_pickle(content)


def test_markers_and_records_are_ours_alone():
    kinds = {type(read_pickle(f"c{module}\n{name}\n.".encode())) for module, name in PERMITTED}
    assert kinds == {Permitted}
    assert type(read_pickle(pickle.dumps(np.zeros(2)))) is Record


@pytest.mark.parametrize(
    "content",
    [
        pytest.param(
            pickle.PROTO + b"\x04N" + b"r\xff\xff\xff\xff.", id="memo index of four thousand million"
        ),
        pytest.param(pickle.PROTO + b"\x05\x8e" + struct.pack("<Q", 2**62) + b"x.", id="bytes of exabytes"),
        pytest.param(
            pickle.PROTO + b"\x05\x96" + struct.pack("<Q", 2**62) + b"x.", id="bytearray of exabytes"
        ),
        pytest.param(pickle.PROTO + b"\x04\x95" + struct.pack("<Q", 2**62) + b"N.", id="frame of exabytes"),
        pytest.param(b"(" * 4_000_000, id="four million marks"),
        pytest.param(b"I" + b"9" * 1_000_000 + b"\n.", id="a million digits"),
        pytest.param(b"}" + b"(" + b"N2" * 30 + b"t" + b"\x86" * 60 + b"Ns.", id="nested tuples as key"),
        pytest.param(b"", id="nothing"),
    ],
)
def test_size_bombs_end_quickly(content):
    # Processor time, and far more than is needed: a hang is caught, a busy machine is none.
    start = time.process_time()
    try:
        value = read_pickle(content)
    except Exception as error:
        assert not isinstance(error, MemoryError)
    else:
        with pytest.raises(ValueError, match=r"where an array was expected|no data"):
            array_of(value)
    assert time.process_time() - start < 30


def test_exponential_keys_are_refused():
    # Each level pairs the level below with itself: 2^80 hashes for one key.
    doubled = b")" + b"2\x86" * 80
    with pytest.raises(RefusedPickleError, match="keys"):
        read_pickle(b"}" + doubled + b"Ns.")


@pytest.mark.parametrize(
    "content",
    [
        pytest.param(
            b"(" + b"I1\nI2\n\x86" * 40_000 + b"l\x85q\x000" + b"ccollections\nOrderedDict\nq\x010"
            + b"h\x01h\x00R0" * 10_000 + b"N.",
            id="one list copied into ten thousand dictionaries",
        ),
        pytest.param(
            b"\x8b" + struct.pack("<i", 10**7) + b"\x7f" * 10**7 + b"q\x000}(" + b"h\x00N" * 50_000 + b"u.",
            id="a giant number as key, again and again",
        ),
    ],
)  # fmt: skip
def test_work_that_is_repeated_is_bounded(content):
    start = time.perf_counter()
    with pytest.raises(RefusedPickleError):
        read_pickle(content)
    assert time.process_time() - start < 30


def _array_state(shape, dtype, data, fortran=False):
    record = Record("ndarray", ())
    record.state = (1, shape, dtype, fortran, data)
    return record


def _dtype(code, order="<"):
    record = Record("dtype", (code, False, True))
    record.state = (3, order, None, None, None, -1, -1, 0)
    return record


@pytest.mark.parametrize(
    ("shape", "code", "data"),
    [
        ((10**12,), "f8", b"x" * 8),
        ((2**40, 2**40), "f8", b""),
        ((-1,), "f8", b"x" * 8),
        ((10**12,), "S0", b""),
        ((1,), "O8", [1]),
        ((1,), "V8", b"x" * 8),
        ((1,), "f7", b"x" * 7),
        ((1,), "f8", [0.0]),
        (("1",), "f8", b"x" * 8),
        ((True,), "f8", b"x" * 8),
        ((1,) * 40, "f8", b"x" * 8),
    ],
)
def test_arrays_that_claim_what_they_do_not_hold_are_refused(shape, code, data):
    with pytest.raises((ValueError, TypeError)):
        array_of(_array_state(shape, _dtype(code), data))


@pytest.mark.parametrize(
    "change",
    [
        {"indices": np.array([0, 99])},
        {"indices": np.array([0, -1])},
        {"indptr": np.array([0, 2, 1, 2])},
        {"indptr": np.array([0, 1, 99, 2])},
        {"indptr": np.array([0, 2])},
        {"data": np.array([1.0])},
        {"_shape": (2**40, 3)},
        {"_shape": (3,)},
        {"indices": np.array([0.0, 1.0])},
        {"indices": np.array([[0, 1]])},
    ],
)
def test_sparse_matrices_with_wrong_pointers_are_refused(change):
    matrix = sp.csc_matrix(np.array([[1.0, 0, 0], [0, 2.0, 0]]))
    content = {"_shape": (2, 3), "data": matrix.data, "indices": matrix.indices, "indptr": matrix.indptr}
    record = Record("csc", ())
    record.state = {
        key: value if isinstance(value, tuple) else read_pickle(pickle.dumps(value))
        for key, value in (content | change).items()
    }
    with pytest.raises(ValueError, match=r"sparse|indices|dimensions"):
        array_of(record)


def test_shapes_made_of_arrays_are_refused():
    # Eight references per level: 8^40 steps if they were followed.
    one = _array_state((), _dtype("i8"), struct.pack("<q", 1))
    for _ in range(40):
        one = _array_state((one,) * 8, _dtype("i8"), struct.pack("<q", 1))
    start = time.perf_counter()
    with pytest.raises(ValueError, match="no whole number"):
        array_of(one)
    assert time.perf_counter() - start < 1


def test_shapes_of_numpy_numbers_are_understood():
    state = {"a": np.arange(6.0), "newshape": (np.int64(2), 3)}
    record = Record("chumpy reshape", ())
    record.state = {key: read_pickle(pickle.dumps(value)) for key, value in state.items()}
    np.testing.assert_array_equal(array_of(record), np.arange(6.0).reshape(2, 3))


def test_chumpy_arrays_nested_without_end_are_refused():
    inner = Record("chumpy", ())
    inner.state = {"x": inner}
    with pytest.raises(ValueError, match="nested"):
        array_of(inner)


@pytest.mark.parametrize("protocol", range(6))
@pytest.mark.parametrize(
    "array",
    [
        np.arange(12, dtype=np.float64).reshape(3, 4),
        np.asfortranarray(np.arange(12, dtype=np.float32).reshape(3, 4)),
        np.arange(5, dtype=">i4"),
        np.array([True, False]),
        np.array(["wrist", "jörg"]),
        np.zeros((0, 3)),
        np.array(7.0),
    ],
)
def test_arrays_of_every_protocol_come_back_exactly(protocol, array):
    result = array_of(read_pickle(pickle.dumps({"a": array}, protocol=protocol))["a"])
    assert result.dtype == array.dtype
    np.testing.assert_array_equal(result, array)


@pytest.mark.parametrize("protocol", range(6))
@pytest.mark.parametrize("layout", [sp.csc_matrix, sp.csr_matrix, sp.coo_matrix, sp.csc_array, sp.coo_array])
def test_sparse_matrices_of_every_protocol_come_back_exactly(protocol, layout):
    dense = np.random.default_rng(0).integers(0, 3, (4, 6)).astype(float)
    result = array_of(read_pickle(pickle.dumps(layout(dense), protocol=protocol)))
    np.testing.assert_array_equal(result.toarray(), dense)


@pytest.mark.parametrize("protocol", range(6))
def test_scalars_and_ordered_dictionaries_are_plain(protocol):
    content = collections.OrderedDict([("a", np.float64(0.1)), ("b", [1, {"c": (2.5, None)}])])
    result = read_pickle(pickle.dumps(content, protocol=protocol))
    assert type(result) is dict
    assert array_of(result["a"]) == 0.1
    assert result["b"] == [1, {"c": (2.5, None)}]


def test_official_research_pickles_hold_only_permitted_names(official, tmp_path, rng):
    path = official.write_chumpy_pickle(tmp_path / "a.pkl", official.official_arrays("mano", rng))
    content = path.read_bytes()
    assert b"chumpy.reordering\nSelect" in content
    assert b"scipy.sparse.csc\ncsc_matrix" in content
    with pytest.raises(ModuleNotFoundError, match="chumpy"):
        pickle.load(io.BytesIO(content), encoding="latin1")
    assert {"shapedirs", "v_template", "J_regressor"} <= set(read_pickle(content))
