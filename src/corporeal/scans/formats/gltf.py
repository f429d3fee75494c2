"""glTF 2.0, as GLB or as JSON with its buffers: all meshes of the scene, at their places, as one.

trimesh reads the buffers and the scene. What Draco compressed is unpacked first; refused is what trimesh
would answer with zeros (otherwise compressed or sparse positions) or with memory that no file can fill.
"""

from __future__ import annotations

import base64
import io
import json
import struct
import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np
import trimesh

from corporeal.scans.formats.draco import has_draco, without_draco
from corporeal.scans.raw import RawScan, no_faces

_GLB_MAGIC = b"glTF"
_FLOAT = 5126
_COMPRESSED = {
    "EXT_meshopt_compression": "meshopt",
    "KHR_meshopt_compression": "meshopt",
}


def parse_glb(data: bytes) -> RawScan:
    """The meshes or points of a GLB file.

    Raises:
        ValueError: no GLB of version 2, compressed geometry but Draco's, counts that the file cannot hold.
    """
    if len(data) < 20 or data[:4] != _GLB_MAGIC:
        raise ValueError("expected a GLB: 'glTF' as the first four bytes")
    version, total, json_bytes = struct.unpack_from("<III", data, 4)
    if version != 2:
        raise ValueError(f"glTF version {version} is not read; save it as glTF 2.0")
    if total > len(data) or json_bytes > len(data) - 20:
        raise ValueError(f"the header says {total} bytes, but the file has {len(data)}: it is cut off")
    document = _document(data[20 : 20 + json_bytes])
    if outside_buffers(document):
        raise ValueError("a GLB that refers to other files is not read; save it with its buffers inside")
    return _loaded(data, "glb", document, {})


def parse_gltf(data: bytes, buffers: Mapping[str, bytes]) -> RawScan:
    """The meshes or points of a glTF file in JSON.

    Args:
        data: the JSON.
        buffers: what the files hold that ``outside_buffers`` names, by their URI.

    Raises:
        ValueError: no glTF 2.0, compressed geometry but Draco's, or counts that the buffers cannot hold.
    """
    return _loaded(data, "gltf", _document(data), buffers)


def outside_buffers(document: Mapping[str, Any]) -> list[str]:
    """URIs of the buffers that stand in files of their own."""
    uris = [buffer.get("uri") for buffer in document.get("buffers", [])]
    return [uri for uri in uris if isinstance(uri, str) and not uri.startswith("data:")]


def buffers_of_json(data: bytes) -> list[str]:
    """URIs of the files that a glTF in JSON needs beside itself."""
    return outside_buffers(_document(data))


def _document(text: bytes) -> dict[str, Any]:
    try:
        document = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"its JSON cannot be read: {error}") from None
    if not isinstance(document, dict):
        raise ValueError("its JSON is no object")
    return document


def _loaded(data: bytes, kind: str, document: dict[str, Any], buffers: Mapping[str, bytes]) -> RawScan:
    inside = [b["uri"] for b in document.get("buffers", []) if str(b.get("uri", "")).startswith("data:")]
    decoded = sum(len(base64.b64decode(uri.partition(",")[2])) for uri in inside)
    if has_draco(document):
        document, contents = without_draco(document, _contents(data, kind, document, buffers))
        buffers = {f"{number}.bin": content for number, content in enumerate(contents)}
        for buffer, uri in zip(document["buffers"], buffers, strict=True):
            buffer["uri"] = uri
        data, kind, decoded = json.dumps(document).encode(), "gltf", 0
    _check_document(document, len(data) + decoded + sum(map(len, buffers.values())))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # numpy's, on transforms with NaN: cleaning drops such points
        scene = trimesh.load_scene(
            io.BytesIO(data), file_type=kind, resolver=dict(buffers), skip_materials=True, process=False
        )
        return _merged(scene, _notes(document))


def _contents(data: bytes, kind: str, document: dict[str, Any], buffers: Mapping[str, bytes]) -> list[bytes]:
    """What the document's buffers hold, in its order."""
    contents = []
    for buffer in document.get("buffers", []):
        uri = buffer.get("uri")
        if uri is None and kind == "glb":  # the binary chunk, behind the JSON and eight bytes of its own
            contents.append(data[28 + struct.unpack_from("<I", data, 12)[0] :][: buffer["byteLength"]])
        elif isinstance(uri, str) and uri.startswith("data:"):
            contents.append(base64.b64decode(uri.partition(",")[2]))
        else:
            contents.append(buffers[uri])
    return contents


def _check_document(document: dict[str, Any], available_bytes: int) -> None:
    accessors = document.get("accessors", [])
    primitives = [primitive for mesh in document.get("meshes", []) for primitive in mesh["primitives"]]
    for primitive in primitives:
        _check_compression(primitive)
    for accessor in accessors:
        if not 0 <= accessor["count"] <= available_bytes:
            raise ValueError(f"an accessor says {accessor['count']} entries, more than the file can hold")
    for primitive in primitives:
        position = accessors[primitive["attributes"]["POSITION"]]
        used = [position] + [accessors[primitive[key]] for key in ("indices",) if key in primitive]
        if any("sparse" in accessor or "bufferView" not in accessor for accessor in used):
            raise ValueError("its mesh has sparse or missing data; save it with plain accessors")
        if position["componentType"] != _FLOAT:
            raise ValueError("its positions are quantised; save it with 32-bit float positions")
    _check_tree(document.get("nodes", []))


def _check_compression(primitive: dict[str, Any]) -> None:
    for name in primitive.get("extensions", {}):
        if name in _COMPRESSED:
            raise ValueError(
                f"its mesh is compressed with {_COMPRESSED[name]} (the extension {name}), which is not read; "
                "save it again without compression"
            )


def _check_tree(nodes: list[dict[str, Any]]) -> None:
    """Every node has one parent at most: otherwise a few nodes could stand for billions of meshes."""
    children = [child for node in nodes for child in node.get("children", [])]
    if len(children) != len(set(children)):
        raise ValueError("a node has two parents; expected a tree")


def _notes(document: dict[str, Any]) -> tuple[str, ...]:
    if document.get("skins"):
        return ("The file's skin was not applied: the mesh was read at its bind pose.",)
    return ()


def _merged(scene: trimesh.Scene, notes: tuple[str, ...]) -> RawScan:
    points, faces, colours, count = [], [], [], 0
    for node in sorted(scene.graph.nodes_geometry):
        transform, name = scene.graph[node]
        geometry = scene.geometry[name]
        if not isinstance(geometry, trimesh.Trimesh | trimesh.PointCloud):
            continue
        placed = np.asarray(geometry.vertices, dtype=np.float64) @ transform[:3, :3].T + transform[:3, 3]
        corners = np.asarray(getattr(geometry, "faces", no_faces()), dtype=np.int64).reshape(-1, 3)
        # A reflection in the scene turns faces inside out, and the order of their corners turns them back.
        mirrored = np.linalg.det(transform[:3, :3]) < 0
        faces.append(RawScan(placed, corners[:, ::-1] if mirrored else corners).faces + count)
        points.append(placed)
        colours.append(_colours(geometry))
        count += len(placed)
    if count == 0:
        raise ValueError("its scene holds no triangles and no points")
    known = [colour for colour in colours if colour is not None]
    return RawScan(
        np.concatenate(points),
        np.concatenate(faces),
        np.concatenate(known) if len(known) == len(colours) else None,
        notes=notes,
    )


def _colours(geometry: trimesh.Trimesh | trimesh.PointCloud) -> np.ndarray | None:
    if isinstance(geometry, trimesh.PointCloud):
        table = np.asarray(geometry.colors)
    elif isinstance(geometry.visual, trimesh.visual.ColorVisuals) and geometry.visual.kind == "vertex":
        table = np.asarray(geometry.visual.vertex_colors)
    else:
        return None
    return table[:, :3].astype(np.uint8) if table.shape[:1] == (len(geometry.vertices),) else None
