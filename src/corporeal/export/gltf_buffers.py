"""Arrays packed into the one binary buffer of a GLB file."""

from __future__ import annotations

import numpy as np
import pygltflib

_COMPONENT_TYPES = {
    np.dtype(np.uint8): pygltflib.UNSIGNED_BYTE,
    np.dtype(np.uint16): pygltflib.UNSIGNED_SHORT,
    np.dtype(np.uint32): pygltflib.UNSIGNED_INT,
    np.dtype(np.float32): pygltflib.FLOAT,
}
_ELEMENT_TYPES = {(): "SCALAR", (3,): "VEC3", (4,): "VEC4", (4, 4): "MAT4"}


class BufferBuilder:
    """Collects arrays and the glTF records (buffer views, accessors) that describe them."""

    def __init__(self) -> None:
        self._content = bytearray()
        self.views: list[pygltflib.BufferView] = []
        self.accessors: list[pygltflib.Accessor] = []

    def add(self, array: np.ndarray, *, target: int | None = None, bounds: bool = False) -> int:
        """Append an array and return the index of its accessor.

        Args:
            array: (N,), (N, 3), (N, 4) or (N, 4, 4) of a type that glTF has; matrices are stored column by
                column, as glTF asks.
            target: ARRAY_BUFFER or ELEMENT_ARRAY_BUFFER for data of the mesh.
            bounds: state the smallest and largest element, which positions and key times must.
        """
        stored = array.swapaxes(1, 2) if array.ndim == 3 else array
        # Every view begins at a multiple of 4, whatever its component type.
        self._content += b"\0" * (-len(self._content) % 4)
        content = np.ascontiguousarray(stored).astype(stored.dtype.newbyteorder("<")).tobytes()
        self.views.append(
            pygltflib.BufferView(
                buffer=0, byteOffset=len(self._content), byteLength=len(content), target=target
            )
        )
        self._content += content
        accessor = pygltflib.Accessor(
            bufferView=len(self.views) - 1,
            componentType=_COMPONENT_TYPES[array.dtype],
            count=len(array),
            type=_ELEMENT_TYPES[array.shape[1:]],
        )
        if bounds:
            accessor.min = np.atleast_1d(array.min(axis=0)).astype(float).tolist()
            accessor.max = np.atleast_1d(array.max(axis=0)).astype(float).tolist()
        self.accessors.append(accessor)
        return len(self.accessors) - 1

    def content(self) -> bytes:
        """The buffer, padded to a multiple of 4 bytes as the GLB container asks."""
        return bytes(self._content) + b"\0" * (-len(self._content) % 4)
