"""Draco's compressed meshes in glTF (KHR_draco_mesh_compression), unpacked before the file is read."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float, Int, UInt8

DRACO = "KHR_draco_mesh_compression"
_BYTE, _UNSIGNED, _FLOAT = 5121, 5125, 5126
# Of the stream: its first bytes; the kind of a mesh; its methods; the flag of metadata before the counts.
_MAGIC, _MESH, _SEQUENTIAL, _EDGEBREAKER, _METADATA = b"DRACO", 1, 0, 1, 0x8000
# Draco spends more than an eighth of a bit on a face or a point of any scan. Counts beyond that are damage,
# for which the decoder would first take memory: 4.6 GB for a file of 87 bytes.
_MOST_PER_BYTE = 64


class DracoMissingError(ValueError):
    """The optional decoder is not installed."""


def has_draco(document: Mapping[str, Any]) -> bool:
    """Whether a primitive of the document is compressed."""
    return any(DRACO in primitive.get("extensions", {}) for primitive in _primitives(document))


def without_draco(document: Mapping[str, Any], buffers: list[bytes]) -> tuple[dict[str, Any], list[bytes]]:
    """The same document with plain accessors, in one more buffer: positions, corners, and colours if any.

    Args:
        document: glTF 2.0.
        buffers: contents of the document's buffers, in its order.

    Returns:
        The document and its buffers. Other attributes are dropped from what was compressed.

    Raises:
        DracoMissingError: the decoder is not installed.
        ValueError: the compressed data are damaged, or no mesh.
    """
    plain = copy.deepcopy(dict(document))
    chunk, number = bytearray(), len(buffers)
    unpacked: dict[int, dict[str, Any]] = {}  # by view: primitives may share one
    for primitive in _primitives(plain):
        extension = primitive.get("extensions", {}).pop(DRACO, None)
        if extension is None:
            continue
        view = extension["bufferView"]
        if view not in unpacked:
            points, faces, colours = _decoded(_view(plain, buffers, view))
            attributes = {"POSITION": _appended(plain, chunk, number, points.astype("<f4"))}
            if colours is not None:
                attributes["COLOR_0"] = _appended(plain, chunk, number, colours)
            corners = _appended(plain, chunk, number, faces.astype("<u4").ravel())
            unpacked[view] = {"attributes": attributes, "indices": corners, "mode": 4}
        primitive.update(unpacked[view])
    for key in ("extensionsRequired", "extensionsUsed"):
        if key in plain:
            plain[key] = [name for name in plain[key] if name != DRACO]
    plain["buffers"] = [*plain.get("buffers", []), {"byteLength": len(chunk)}]
    return plain, [*buffers, bytes(chunk)]


def _primitives(document: Mapping[str, Any]) -> list[dict[str, Any]]:
    return [primitive for mesh in document.get("meshes", []) for primitive in mesh["primitives"]]


def _view(document: Mapping[str, Any], buffers: list[bytes], number: int) -> bytes:
    views = document["bufferViews"]
    if not 0 <= number < len(views) or not 0 <= views[number]["buffer"] < len(buffers):
        raise ValueError("a compressed mesh refers to a buffer that is not there")
    view = views[number]
    begin, size = view.get("byteOffset", 0), view["byteLength"]
    data = buffers[view["buffer"]][max(begin, 0) : begin + size]
    if begin < 0 or size <= 0 or len(data) != size:
        raise ValueError("a compressed mesh reaches beyond its buffer: the file is cut off")
    return data


def _decoded(
    data: bytes,
) -> tuple[Float[np.ndarray, "N 3"], Int[np.ndarray, "M 3"], UInt8[np.ndarray, "N 4"] | None]:
    try:
        import DracoPy
    except ImportError as error:
        raise DracoMissingError(
            f"its mesh is compressed with Draco (the extension {DRACO}), whose decoder is not installed "
            '(pip install "corporeal[draco]"); or save it again without compression'
        ) from error
    _check_header(data)
    try:
        mesh = DracoPy.decode(data)
    except Exception as error:  # its own classes, which share no base
        raise ValueError(f"its Draco data are damaged: {error}") from None
    points = np.asarray(mesh.points, dtype=np.float64).reshape(-1, 3)
    faces = np.asarray(mesh.faces, dtype=np.int64).reshape(-1, 3)
    if not len(faces) or faces.min() < 0 or faces.max() >= len(points):
        raise ValueError("its Draco data hold no triangles between their points")
    colours = mesh.colors
    if colours is None or np.asarray(colours).dtype != np.uint8 or len(colours) != len(points):
        return points, faces, None
    opaque = np.full((len(points), 4), 255, dtype=np.uint8)
    opaque[:, : colours.shape[1]] = colours[:, :4]
    return points, faces, opaque


def _check_header(data: bytes) -> None:
    """Refuse what is no mesh of the version that glTF asks for, and counts that the data cannot hold."""
    if len(data) < 16 or data[:5] != _MAGIC:
        raise ValueError("its compressed mesh is no Draco data")
    version, kind, method = (data[5], data[6]), data[7], data[8]
    if version != (2, 2) or kind != _MESH or method not in (_SEQUENTIAL, _EDGEBREAKER):
        raise ValueError("its Draco data are no mesh of version 2.2; save it again without compression")
    if int.from_bytes(data[9:11], "little") & _METADATA:
        raise ValueError("its Draco data begin with metadata, which are not read; save it without them")
    first, place = _varint(data, 12 if method == _EDGEBREAKER else 11)
    second, _ = _varint(data, place)
    if max(first, second) > _MOST_PER_BYTE * len(data):
        raise ValueError(f"its Draco data say {max(first, second)} faces or points, more than they can hold")


def _varint(data: bytes, place: int) -> tuple[int, int]:
    """A number of seven bits a byte, the lowest first, and the place behind it."""
    value = 0
    for shift in range(0, 35, 7):
        if place >= len(data):
            break
        byte = data[place]
        value, place = value | (byte & 0x7F) << shift, place + 1
        if byte < 0x80:
            return value, place
    raise ValueError("its Draco data are damaged: a count does not end")


def _appended(document: dict[str, Any], chunk: bytearray, buffer: int, values: np.ndarray) -> int:
    """Number of a new accessor whose values stand at the end of the chunk."""
    views, accessors = document.setdefault("bufferViews", []), document.setdefault("accessors", [])
    views.append({"buffer": buffer, "byteOffset": len(chunk), "byteLength": values.nbytes})
    chunk += values.tobytes()
    accessor: dict[str, Any] = {
        "bufferView": len(views) - 1,
        "componentType": {"f": _FLOAT, "u": _UNSIGNED}[values.dtype.kind] if values.itemsize == 4 else _BYTE,
        "count": len(values),
        "type": "SCALAR" if values.ndim == 1 else f"VEC{values.shape[1]}",
    }
    if values.dtype.kind == "f":
        accessor |= {"min": values.min(0).tolist(), "max": values.max(0).tolist()}
    if values.itemsize == 1:
        accessor["normalized"] = True
    accessors.append(accessor)
    return len(accessors) - 1
