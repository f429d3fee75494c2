"""Draco in glTF: unpacked by the optional decoder, refused with a sentence without it."""

import base64
import json
import struct
import subprocess
import sys

import numpy as np
import pytest
import trimesh

from corporeal.scans.files import ScanFileError, read_scan

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
    decoder = pytest.importorskip("DracoPy")
    return decoder.encode(_MESH.vertices, _MESH.faces.astype(np.uint32), quantization_bits=16)


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
        "import sys; from pathlib import Path; from corporeal.scans.files import ScanFileError, read_scan\n"
        "for path in sorted(Path(sys.argv[1]).glob('*.glb')):\n"
        "    try: read_scan(path, 'm')\n"
        "    except ScanFileError as error: assert str(path.name) in str(error)\n"
        "print('survived')"
    )
    ended = subprocess.run(
        [sys.executable, "-c", program, tmp_path], capture_output=True, text=True, timeout=120, check=False
    )
    assert ended.stdout.strip() == "survived", ended.stderr[-2000:]


def test_without_the_decoder_the_error_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "DracoPy", None)
    (tmp_path / "a.glb").write_bytes(_glb(b"DRACO" + bytes(95)))
    with pytest.raises(ScanFileError, match=r"corporeal\[draco\]"):
        read_scan(tmp_path / "a.glb")
