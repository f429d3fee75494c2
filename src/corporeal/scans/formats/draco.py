"""Draco's compressed meshes in glTF (KHR_draco_mesh_compression), unpacked before the file is read."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float, Int

DRACO = "KHR_draco_mesh_compression"
_FLOAT, _UNSIGNED = 5126, 5125
_MAGIC = b"DRACO"
# Draco spends more than a bit on a face or a point of any scan: a header that says more is damaged.
_MOST_PER_BYTE = 64


class DracoMissingError(ValueError):
    """The optional decoder is not installed."""


def has_draco(document: Mapping[str, Any]) -> bool:
    """Whether a primitive of the document is compressed."""
    return any(DRACO in primitive.get("extensions", {}) for primitive in _primitives(document))


def without_draco(document: Mapping[str, Any], buffers: list[bytes]) -> tuple[dict[str, Any], list[bytes]]:
    """The same document with plain accessors, in one more buffer; positions and corners only.

    Args:
        document: glTF 2.0.
        buffers: contents of the document's buffers, in its order.

    Returns:
        The document and its buffers. Attributes but POSITION are dropped from what was compressed.

    Raises:
        DracoMissingError: the decoder is not installed.
        ValueError: the compressed data are damaged.
    """
    plain = copy.deepcopy(dict(document))
    chunk = bytearray()
    number = len(buffers)
    for primitive in _primitives(plain):
        extension = primitive.get("extensions", {}).pop(DRACO, None)
        if extension is None:
            continue
        points, faces = _decoded(_view(plain, buffers, extension["bufferView"]))
        position = _appended(plain, chunk, number, points.astype("<f4"), "VEC3", _FLOAT)
        corners = _appended(plain, chunk, number, faces.astype("<u4").ravel(), "SCALAR", _UNSIGNED)
        primitive |= {"attributes": {"POSITION": position}, "indices": corners, "mode": 4}
    for key in ("extensionsRequired", "extensionsUsed"):
        if key in plain:
            plain[key] = [name for name in plain[key] if name != DRACO]
    plain["buffers"] = [*plain.get("buffers", []), {"byteLength": len(chunk)}]
    return plain, [*buffers, bytes(chunk)]


def _primitives(document: Mapping[str, Any]) -> list[dict[str, Any]]:
    return [primitive for mesh in document.get("meshes", []) for primitive in mesh["primitives"]]


def _view(document: Mapping[str, Any], buffers: list[bytes], number: int) -> bytes:
    view = document["bufferViews"][number]
    begin, size = view.get("byteOffset", 0), view["byteLength"]
    data = buffers[view["buffer"]][begin : begin + size]
    if begin < 0 or size <= 0 or len(data) != size:
        raise ValueError("a compressed mesh reaches beyond its buffer: the file is cut off")
    return data


def _decoded(data: bytes) -> tuple[Float[np.ndarray, "N 3"], Int[np.ndarray, "M 3"]]:
    try:
        import DracoPy
    except ImportError as error:
        raise DracoMissingError(
            f"its mesh is compressed with Draco (the extension {DRACO}), whose decoder is not installed "
            '(pip install "corporeal[draco]"); or save it again without compression'
        ) from error
    if data[:5] != _MAGIC:
        raise ValueError("its compressed mesh is no Draco data")
    try:
        mesh = DracoPy.decode(data)
    except Exception as error:  # its own classes, which share no base
        raise ValueError(f"its Draco data are damaged: {error}") from None
    points = np.asarray(mesh.points, dtype=np.float64).reshape(-1, 3)
    faces = np.asarray(getattr(mesh, "faces", np.zeros((0, 3))), dtype=np.int64).reshape(-1, 3)
    if max(len(points), len(faces)) > _MOST_PER_BYTE * len(data):
        raise ValueError("its Draco data hold more than their size allows")
    if not len(faces) or faces.min() < 0 or faces.max() >= len(points):
        raise ValueError("its Draco data hold no triangles between their points")
    return points, faces


def _appended(
    document: dict[str, Any], chunk: bytearray, buffer: int, values: np.ndarray, kind: str, component: int
) -> int:
    """Number of a new accessor whose values stand at the end of the chunk."""
    document.setdefault("bufferViews", []).append(
        {"buffer": buffer, "byteOffset": len(chunk), "byteLength": values.nbytes}
    )
    chunk += values.tobytes()
    accessor = {
        "bufferView": len(document["bufferViews"]) - 1,
        "componentType": component,
        "count": len(values),
        "type": kind,
    }
    if kind == "VEC3":
        accessor |= {"min": values.min(0).tolist(), "max": values.max(0).tolist()}
    document["accessors"].append(accessor)
    return len(document["accessors"]) - 1
