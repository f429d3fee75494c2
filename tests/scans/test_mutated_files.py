"""Two hundred damaged files of every format: each ends in a clear error or a valid scan, and soon."""

import json
import struct
import time

import numpy as np
import pytest
import trimesh

from corporeal.scans.files import ScanFileError, read_scan

MUTATIONS = 200
SECONDS = 5.0  # the slowest takes 0.1; a hang takes for ever

_BALL = trimesh.creation.icosphere(subdivisions=1, radius=0.15)
_MESH = trimesh.Trimesh(
    _BALL.vertices, _BALL.faces, vertex_colors=np.full((len(_BALL.vertices), 4), 128), process=False
)
_CLOUD = trimesh.PointCloud(trimesh.creation.icosphere(subdivisions=2, radius=0.15).vertices)


def _coff() -> bytes:
    lines = ["COFF", f"{len(_MESH.vertices)} {len(_MESH.faces)} 0"]
    lines += [f"{x} {y} {z} 10 20 30 255" for x, y, z in _MESH.vertices]
    lines += [f"3 {a} {b} {c}" for a, b, c in _MESH.faces]
    return "\n".join(lines).encode()


def _big_endian_ply() -> bytes:
    header = f"ply\nformat binary_big_endian 1.0\nelement vertex {len(_MESH.vertices)}\n"
    header += "".join(f"property float {axis}\n" for axis in "xyz")
    header += f"element face {len(_MESH.faces)}\nproperty list uchar int vertex_index\nend_header\n"
    body = np.asarray(_MESH.vertices).astype(">f4").tobytes()
    return header.encode() + body + b"".join(struct.pack(">Biii", 3, *map(int, f)) for f in _MESH.faces)


def _gltf() -> bytes:
    files = trimesh.Scene(_MESH).export(file_type="gltf", embed_buffers=True)
    return files["model.gltf"]


FILES = {
    "ascii.ply": _MESH.export(file_type="ply", encoding="ascii"),
    "little.ply": _MESH.export(file_type="ply", encoding="binary"),
    "big.ply": _big_endian_ply(),
    "cloud.ply": _CLOUD.export(file_type="ply"),
    "mesh.obj": _MESH.export(file_type="obj").encode(),
    "binary.stl": _MESH.export(file_type="stl"),
    "ascii.stl": _MESH.export(file_type="stl_ascii").encode(),
    "mesh.off": _coff(),
    "mesh.glb": _MESH.export(file_type="glb"),
    "mesh.gltf": _gltf(),
}
_WORDS = [
    b"nan",
    b"inf",
    b"-1",
    b"1e308",
    b"99999999999999999999",
    b"4294967295",
    b"",
    b"\x00",
    b"x",
    b"0",
    b"\n",
]


def flip_bytes(data: bytearray, rng) -> bytearray:
    for place in rng.integers(0, len(data), rng.integers(1, 20)):
        data[place] = rng.integers(0, 256)
    return data


def flip_bits_of_the_head(data: bytearray, rng) -> bytearray:
    for place in rng.integers(0, min(len(data), 700), rng.integers(1, 6)):
        data[place] ^= 1 << rng.integers(0, 8)
    return data


def truncate(data: bytearray, rng) -> bytearray:
    return data[: rng.integers(0, len(data))]


def insert_garbage(data: bytearray, rng) -> bytearray:
    place = rng.integers(0, len(data))
    return data[:place] + bytearray(rng.bytes(rng.integers(1, 300))) + data[place:]


def cut_out(data: bytearray, rng) -> bytearray:
    begin, end = np.sort(rng.integers(0, len(data), 2))
    return data[:begin] + data[end:]


def replace_numbers(data: bytearray, rng) -> bytearray:
    """Digits become NaN, huge, negative or no numbers."""
    digits = [place for place, byte in enumerate(data) if 48 <= byte <= 57]
    for place in rng.choice(digits, min(len(digits), int(rng.integers(1, 6))), replace=False):
        data = data[:place] + bytearray(_WORDS[rng.integers(len(_WORDS))]) + data[place + 1 :]
    return data


def replace_binary_numbers(data: bytearray, rng) -> bytearray:
    """Four aligned bytes become -1, NaN, infinity or a huge number."""
    for place in 4 * rng.integers(0, max(len(data) // 4, 1), rng.integers(1, 10)):
        data[place : place + 4] = [
            b"\xff\xff\xff\xff",
            b"\x00\x00\xc0\x7f",
            b"\x00\x00\x80\x7f",
            b"\xff\xff\xff\x7f",
        ][rng.integers(4)]
    return data


DAMAGES = [
    flip_bytes,
    flip_bits_of_the_head,
    truncate,
    insert_garbage,
    cut_out,
    replace_numbers,
    replace_binary_numbers,
]


def assert_valid(scan) -> None:
    assert np.isfinite(scan.points).all() and len(scan.points) > 0
    assert scan.normals.shape == scan.points.shape and np.isfinite(scan.normals).all()
    if len(scan.faces):
        assert scan.faces.min() >= 0 and scan.faces.max() < len(scan.points)
    assert 0.08 < scan.diagonal < 0.9


@pytest.mark.parametrize("name", FILES)
def test_damage_ends_in_an_error_or_a_valid_scan(tmp_path, rng, name):
    assert_valid(read_scan(tmp_path_with(tmp_path, name, FILES[name]), "m"))
    refused = 0
    for number in range(MUTATIONS):
        damaged = DAMAGES[number % len(DAMAGES)](bytearray(FILES[name]), rng)
        path = tmp_path_with(tmp_path, name, bytes(damaged))
        begin = time.perf_counter()
        try:
            assert_valid(read_scan(path, "free"))
        except ScanFileError as error:
            refused += 1
            assert str(error).startswith(name) and len(str(error)) > len(name) + 20
        assert time.perf_counter() - begin < SECONDS
    assert 0 < refused < MUTATIONS  # the damage is neither hopeless nor harmless


def tmp_path_with(tmp_path, name: str, data: bytes):
    path = tmp_path / name
    path.write_bytes(data)
    return path


@pytest.mark.parametrize("suffix", ["ply", "obj", "stl", "off", "glb", "gltf"])
def test_a_file_of_another_format_is_refused(tmp_path, suffix):
    for name, data in FILES.items():
        if not name.endswith(suffix):
            with pytest.raises(ScanFileError):
                read_scan(tmp_path_with(tmp_path, f"a.{suffix}", data), "free")


def test_json_of_any_shape_is_refused(tmp_path):
    documents = [None, 3, [], {}, {"meshes": [{}]}, {"meshes": 3}, {"nodes": [3]}, {"buffers": [{"uri": 3}]}]
    documents += [{"accessors": [{"count": -1}]}, {"accessors": [{"count": "many"}]}, {"buffers": "none"}]
    for document in documents:
        with pytest.raises(ScanFileError):
            read_scan(tmp_path_with(tmp_path, "a.gltf", json.dumps(document).encode()))
