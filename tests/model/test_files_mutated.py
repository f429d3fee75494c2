"""Damaged model files: each ends in a clear error or a valid load, never in a crash or a hang."""

import functools
import io
import json
import struct
import time
import zipfile

import numpy as np
import pytest

from corporeal.model.files import LeftHandWarning, ModelFileError, load_model, save_model
from corporeal.model.surface_model import SurfaceModel

COUNT = 200
SECONDS = 2.0
SIZE = (40, 50, 10)


@pytest.fixture(scope="module")
def originals(official, tmp_path_factory) -> dict[str, bytes]:
    """One small sound file of each format."""
    folder = tmp_path_factory.mktemp("originals")
    rng = np.random.default_rng(7)
    arrays = official.official_arrays("mano", rng, SIZE)
    face = official.official_arrays("smplx", rng, (*SIZE[:2], 20))
    paths = {
        "official npz": official.write_npz(folder / "official.npz", face),
        "plain pkl": official.write_plain_pickle(folder / "plain.pkl", arrays),
        "research pkl": official.write_chumpy_pickle(folder / "research.pkl", arrays),
    }
    for ending in ("npz", "pkl"):
        paths[f"native {ending}"] = folder / f"native.{ending}"
        save_model(load_model(paths["official npz"]), paths[f"native {ending}"])
    return {name: path.read_bytes() for name, path in paths.items()}


def _flipped(content: bytes, rng) -> bytes:
    changed = bytearray(content)
    for position in rng.integers(0, len(changed), rng.integers(1, 6)):
        changed[position] ^= 1 << int(rng.integers(8))
    return bytes(changed)


def _flipped_early(content: bytes, rng) -> bytes:
    """Flips where formats keep their structure, not in the long stretches of numbers."""
    window = min(len(content), 400)
    return _flipped(content[:window], rng) + content[window:]


def _truncated(content: bytes, rng) -> bytes:
    return content[: int(rng.integers(len(content)))]


def _spliced(content: bytes, rng) -> bytes:
    start, end, goal = sorted(int(p) for p in rng.integers(0, len(content), 3))
    return content[:start] + content[end:goal] + content[start:]


def _large_claim(content: bytes, rng) -> bytes:
    position = int(rng.integers(len(content) - 8))
    claim = struct.pack("<Q", 2 ** (31, 32, 40, 63, 64)[int(rng.integers(5))] - 1)
    return content[:position] + claim + content[position + 8 :]


def _with_damaged_member(content: bytes, rng) -> bytes:
    """Damages inside an archive under a checksum that is right again."""
    result = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(content)) as old, zipfile.ZipFile(result, "w") as new:
        names = old.namelist()
        chosen = names[int(rng.integers(len(names)))]
        for name in names:
            member = old.read(name)
            damage = (_flipped_early, _truncated, _large_claim)[int(rng.integers(3))]
            new.writestr(name, damage(member, rng) if name == chosen else member)
    return result.getvalue()


ARRAY_DAMAGES = {
    "shorter": lambda array, rng: array[:-1],
    "longer": lambda array, rng: np.concatenate([array, array[:1]]),
    "another axis": lambda array, rng: array[None],
    "turned": lambda array, rng: array.T,
    "flat": lambda array, rng: array.ravel()[:-1],
    "empty": lambda array, rng: array[:0],
    "one number": lambda array, rng: np.array(3.0),
    "text": lambda array, rng: array.astype(str),
    "complex": lambda array, rng: array * (1 + 1j),
    "objects": lambda array, rng: array.astype(object),
    "bytes": lambda array, rng: (array * 100).astype(np.int8),
    "records": lambda array, rng: np.zeros(array.shape, dtype=[("a", "f8")]),
    "times": lambda array, rng: array.astype(np.int64).astype("datetime64[s]"),
    "big-endian": lambda array, rng: array.astype(">f8"),
    "NaN": lambda array, rng: _with_entry(array, rng, np.nan),
    "infinite": lambda array, rng: _with_entry(array, rng, -np.inf),
    "huge": lambda array, rng: _with_entry(array, rng, 1e300),
    "large": lambda array, rng: _with_entry(array, rng, 10**6),
    "negative": lambda array, rng: _with_entry(array, rng, -5),
    "fraction": lambda array, rng: _with_entry(array, rng, 0.5),
    "missing": lambda array, rng: None,
}


def _with_entry(array, rng, value):
    changed = array.astype(np.float64)
    changed.flat[int(rng.integers(changed.size))] = value
    return changed


def _with_damaged_array(content: bytes, rng) -> bytes:
    with np.load(io.BytesIO(content), allow_pickle=True) as archive:
        arrays = {key: archive[key] for key in archive.files}
    numeric = [
        key for key, array in arrays.items() if array.dtype.kind in "fiu" and array.ndim and array.size
    ]
    key = numeric[int(rng.integers(len(numeric)))]
    names = sorted(ARRAY_DAMAGES)
    damaged = ARRAY_DAMAGES[names[int(rng.integers(len(names)))]](arrays[key], rng)
    arrays = {name: array for name, array in arrays.items() if name != key or damaged is not None}
    if damaged is not None:
        arrays[key] = damaged
    result = io.BytesIO()
    np.savez(result, **arrays)
    return result.getvalue()


BYTE_DAMAGES = [_flipped, _flipped_early, _truncated, _spliced, _large_claim]
ARCHIVE_DAMAGES = [*BYTE_DAMAGES, *[_with_damaged_member] * 5, *[_with_damaged_array] * 10]


def _outcome(path) -> str:
    start = time.perf_counter()
    try:
        model = load_model(path)
    except ModelFileError as error:
        assert str(path) in str(error)
        assert "\n" not in str(error)
        outcome = "refused"
    else:
        assert isinstance(model, SurfaceModel)
        assert np.isfinite(model.template).all()
        assert model.skinning_weights.shape == (model.vertex_count, model.joint_count)
        outcome = "loaded"
    assert time.perf_counter() - start < SECONDS
    return outcome


@pytest.mark.filterwarnings(f"ignore::{LeftHandWarning.__module__}.{LeftHandWarning.__name__}")
@pytest.mark.parametrize("name", ["native npz", "official npz", "native pkl", "plain pkl", "research pkl"])
def test_damaged_files_end_in_a_clear_error_or_a_valid_load(originals, name, tmp_path):
    rng = np.random.default_rng(len(name))
    damages = ARCHIVE_DAMAGES if name.endswith("npz") else BYTE_DAMAGES
    path = tmp_path / "damaged.bin"
    outcomes = []
    for number in range(COUNT):
        path.write_bytes(damages[number % len(damages)](originals[name], rng))
        outcomes.append(_outcome(path))
    # Most damage must be seen; some of it (a digit of a coordinate) cannot be.
    assert outcomes.count("refused") > COUNT / 3
    path.write_bytes(originals[name])
    assert _outcome(path) == "loaded"


KEYS = ["v_template", "f", "shapedirs", "posedirs", "J_regressor", "weights", "kintree_table", "hands_mean"]
FATAL = ["shorter", "another axis", "one number", "text", "complex", "objects", "records", "NaN", "infinite"]

# Fewer faces are still faces.
FATAL_PAIRS = [(key, damage) for key in KEYS for damage in FATAL if (key, damage) != ("f", "shorter")]


@pytest.mark.parametrize(("key", "damage"), FATAL_PAIRS)
def test_every_wrong_array_is_refused_by_its_name(official, key, damage, tmp_path, rng):
    arrays = official.official_arrays("mano", rng, SIZE)
    damaged = ARRAY_DAMAGES[damage](arrays[key], rng)
    path = official.write_npz(tmp_path / "a.npz", arrays | {key: damaged})
    with pytest.raises(ModelFileError) as caught:
        load_model(path)
    if damage in ("NaN", "infinite", "another axis", "one number", "text", "complex", "records"):
        assert repr(key) in str(caught.value)


@functools.cache
def _damaged_headers() -> list[tuple[str, object]]:
    return [
        ("layout", 2), ("layout", "1"), ("name", 3), ("side", "up"), ("shape_count", -1),
        ("shape_count", 10**9), ("shape_count", True), ("expression_count", 11), ("correctives", 1),
        ("joint_names", ["a"]), ("joint_names", 7), ("parts", ["x"]), ("blocks", [{}]), ("blocks", None),
        ("landmarks", [{"name": "x", "names": []}]), ("landmarks", {}), ("notes", []), ("notes", {"a": 1}),
        ("cut_joint", 0), ("cut_joint", 99), ("cut_joint", 0.0),
    ]  # fmt: skip


@pytest.mark.parametrize(("key", "value"), _damaged_headers())
def test_every_wrong_header_is_refused(originals, key, value, tmp_path):
    with np.load(io.BytesIO(originals["native npz"])) as archive:
        arrays = {name: archive[name] for name in archive.files}
    header = json.loads(str(arrays["corporeal_header"])) | {key: value}
    np.savez(tmp_path / "a.npz", **arrays | {"corporeal_header": np.array(json.dumps(header))})
    with pytest.raises(ModelFileError):
        load_model(tmp_path / "a.npz")
