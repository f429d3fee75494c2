"""Arrays packed into the one binary buffer of a GLB file."""

from __future__ import annotations

import numpy as np
import pygltflib
from jaxtyping import Float

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
        accessor = pygltflib.Accessor(
            bufferView=self._view(stored, target),
            componentType=_COMPONENT_TYPES[array.dtype],
            count=len(array),
            type=_ELEMENT_TYPES[array.shape[1:]],
        )
        if bounds:
            _state_bounds(accessor, array)
        self.accessors.append(accessor)
        return len(self.accessors) - 1

    def add_displacements(self, displacements: Float[np.ndarray, "V 3"]) -> int:
        """Append a morph target; only its rows that are not zero are stored where that is shorter."""
        moved = np.flatnonzero(np.any(displacements != 0, axis=1))
        index_type = np.uint16 if len(displacements) <= np.iinfo(np.uint16).max else np.uint32
        full = displacements.nbytes
        if (
            not len(moved)
            or len(moved) * (np.dtype(index_type).itemsize + full // len(displacements)) >= full
        ):
            return self.add(displacements, target=pygltflib.ARRAY_BUFFER, bounds=True)
        indices = self._view(moved.astype(index_type))
        values = self._view(displacements[moved])
        accessor = pygltflib.Accessor(
            byteOffset=None,
            componentType=_COMPONENT_TYPES[displacements.dtype],
            count=len(displacements),
            type="VEC3",
            sparse=pygltflib.Sparse(
                count=len(moved),
                indices=pygltflib.AccessorSparseIndices(
                    bufferView=indices, componentType=_COMPONENT_TYPES[np.dtype(index_type)]
                ),
                values=pygltflib.AccessorSparseValues(bufferView=values),
            ),
        )
        _state_bounds(accessor, displacements)
        self.accessors.append(accessor)
        return len(self.accessors) - 1

    def content(self) -> bytes:
        """The buffer, padded to a multiple of 4 bytes as the GLB container asks."""
        return bytes(self._content) + b"\0" * (-len(self._content) % 4)

    def _view(self, array: np.ndarray, target: int | None = None) -> int:
        """Append the bytes of an array; the index of their buffer view."""
        # Every view begins at a multiple of 4, whatever its component type.
        self._content += b"\0" * (-len(self._content) % 4)
        content = np.ascontiguousarray(array).astype(array.dtype.newbyteorder("<")).tobytes()
        self.views.append(
            pygltflib.BufferView(
                buffer=0, byteOffset=len(self._content), byteLength=len(content), target=target
            )
        )
        self._content += content
        return len(self.views) - 1


def _state_bounds(accessor: pygltflib.Accessor, array: np.ndarray) -> None:
    accessor.min = np.atleast_1d(array.min(axis=0)).astype(float).tolist()
    accessor.max = np.atleast_1d(array.max(axis=0)).astype(float).tolist()
