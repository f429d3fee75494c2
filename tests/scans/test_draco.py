"""Draco in glTF: unpacked by the optional decoder, refused with a sentence without it."""

import base64
import copy
import json
import struct
import subprocess
import sys

import DracoPy
import numpy as np
import pytest
import trimesh

from corporeal.scans.files import ScanFileError, read_scan
from corporeal.scans.formats.draco import without_draco

_MESH = trimesh.creation.icosphere(subdivisions=3, radius=0.1)


def _document(packed):
    return {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "scale": [1, 2, 1]}],
        "extensionsRequired": ["KHR_draco_mesh_compression"],
        "extensionsUsed": ["KHR_draco_mesh_compression"],
        "buffers": [{"byteLength": len(packed)}],
        "bufferViews": [{"buffer": 0, "byteLength": len(packed)}],
        "accessors": [
            {"componentType": 5123, "count": 3 * len(_MESH.faces), "type": "SCALAR"},
            {"componentType": 5126, "count": len(_MESH.vertices), "type": "VEC3"},
        ],
        "meshes": [
            {
                "primitives": [
                    {
                        "attributes": {"POSITION": 1},
                        "indices": 0,
                        "extensions": {
                            "KHR_draco_mesh_compression": {"bufferView": 0, "attributes": {"POSITION": 0}}
                        },
                    }
                ]
            }
        ],
    }


def _glb(packed):
    text = json.dumps(_document(packed)).encode()
    text += b" " * (-len(text) % 4)
    body = packed + b"\0" * (-len(packed) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(body), b"BIN\0") + body
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


@pytest.fixture(scope="module")
def packed():
    return DracoPy.encode(_MESH.vertices, _MESH.faces.astype(np.uint32), quantization_bits=16)


def test_a_packed_mesh_is_read_at_its_place(packed, tmp_path):
    (tmp_path / "a.glb").write_bytes(_glb(packed))
    document = _document(packed)
    document["buffers"][0]["uri"] = (
        "data:application/octet-stream;base64," + base64.b64encode(packed).decode()
    )
    (tmp_path / "b.gltf").write_text(json.dumps(document))
    document["buffers"][0]["uri"] = "c.bin"
    (tmp_path / "c.bin").write_bytes(packed)
    (tmp_path / "c.gltf").write_text(json.dumps(document))
    for name in ("a.glb", "b.gltf", "c.gltf"):
        scan = read_scan(tmp_path / name, "m")
        assert scan.points.shape == _MESH.vertices.shape and scan.faces.shape == _MESH.faces.shape
        np.testing.assert_allclose(np.linalg.norm(scan.points / [1, 2, 1], axis=1), 0.1, atol=1e-5)
        assert trimesh.Trimesh(scan.points, scan.faces, process=False).volume > 0


def test_damaged_draco_ends_in_a_sentence(packed, tmp_path):
    """In a process of its own, since the decoder is not Python: it must not die of any of them."""
    rng = np.random.default_rng(5)
    for number in range(200):
        damaged = bytearray(packed)
        for place in rng.integers(len(packed), size=rng.integers(1, 9)):
            damaged[place] = rng.integers(256)
        cut = len(packed) if number % 3 else int(rng.integers(1, len(packed)))
        (tmp_path / f"{number:03d}.glb").write_bytes(_glb(bytes(damaged[:cut])))
    program = (
        "import sys; refused = 0; from pathlib import Path\n"
        "from corporeal.scans.files import ScanFileError, read_scan\n"
        "for path in sorted(Path(sys.argv[1]).glob('*.glb')):\n"
        "    try: read_scan(path, 'm')\n"
        "    except ScanFileError as error: refused += 1; assert str(path.name) in str(error)\n"
        "print('refused', refused)"
    )
    ended = subprocess.run(
        [sys.executable, "-c", program, tmp_path], capture_output=True, text=True, timeout=120, check=False
    )
    assert ended.returncode == 0, ended.stderr[-2000:]
    assert 100 < int(ended.stdout.split()[-1]) <= 200


def test_without_the_decoder_the_error_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "DracoPy", None)
    (tmp_path / "a.glb").write_bytes(_glb(b"DRACO" + bytes(95)))
    with pytest.raises(ScanFileError, match=r"corporeal\[draco\]"):
        read_scan(tmp_path / "a.glb")


def test_counts_that_the_data_cannot_hold_are_refused_before_memory_is_taken(packed, tmp_path):
    huge = b"\xff\xff\xff\xff\x07"
    mesh = b"DRACO\x02\x02\x01"
    for header, words in (
        (mesh + b"\x00\x00\x00" + huge + huge, "more than they can hold"),
        (mesh + b"\x01\x00\x00\x00\x05" + huge, "more than they can hold"),
        (mesh + b"\x01\x00\x00\x00" + b"\xff" * 9, "does not end"),
        (mesh + b"\x01\x00\x80", "metadata"),
        (b"DRACO\x02\x03\x00\x01\x00\x00" + huge, "no mesh"),
        (b"DRACA", "no Draco data"),
    ):
        (tmp_path / "a.glb").write_bytes(_glb(header + bytes(60)))
        with pytest.raises(ScanFileError, match=words):
            read_scan(tmp_path / "a.glb", "m")


def test_primitives_that_share_data_are_unpacked_once(packed):
    document = _document(packed)
    one = document["meshes"][0]["primitives"][0]
    document["meshes"][0]["primitives"] = [copy.deepcopy(one) for _ in range(200)]
    plain, buffers = without_draco(document, [packed])
    assert len(buffers[1]) == 12 * len(_MESH.vertices) + 12 * len(_MESH.faces)
    assert len({primitive["indices"] for primitive in plain["meshes"][0]["primitives"]}) == 1
    for views in ([{"buffer": -1, "byteLength": 9}], [{"buffer": 0, "byteOffset": -4, "byteLength": 9}], []):
        with pytest.raises(ValueError, match="buffer"):
            without_draco(document | {"bufferViews": views}, [packed])


def test_colours_are_kept(tmp_path):
    colours = np.random.default_rng(3).integers(0, 256, (len(_MESH.vertices), 3)).astype(np.uint8)
    packed = DracoPy.encode(
        _MESH.vertices, _MESH.faces.astype(np.uint32), colors=colours, preserve_order=True
    )
    (tmp_path / "a.glb").write_bytes(_glb(packed))
    scan = read_scan(tmp_path / "a.glb", "m")
    np.testing.assert_array_equal(np.sort(scan.colours, axis=0), np.sort(colours, axis=0))
