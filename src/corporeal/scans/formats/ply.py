"""PLY: ASCII and binary of both byte orders, meshes and point clouds, colours and normals.

Own reader: trimesh refuses binary files whose faces differ in their number of corners, takes a mesh with an
edge table for a path, and stops an ASCII number that it cannot read short instead of refusing it.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64, Shaped

from corporeal.scans.formats.ply_header import Element, Encoding, Property, parse_ply_header
from corporeal.scans.raw import RawScan, eight_bit, fans, indices, no_faces, numbers

Columns = dict[str, Shaped[np.ndarray, "..."]]
"""A column is (rows,). A list is two columns: ``name`` has the entries of all rows, ``name#`` the lengths."""

_INDEX_NAMES = ("vertex_indices", "vertex_index")


def parse_ply(data: bytes) -> RawScan:
    """The mesh or the point cloud of a PLY file.

    Raises:
        ValueError: the file is no PLY, is cut off, or has no vertices with x, y and z.
    """
    encoding, elements, body = parse_ply_header(data)
    if any(element.name == "tristrips" and element.count for element in elements):
        raise ValueError("triangle strips are not read; save the mesh with plain triangles")
    if encoding == "ascii":
        tables = _ascii_tables(elements, numbers(data[body:].split(), "body"))
    else:
        tables = _binary_tables(elements, encoding, memoryview(data)[body:])
    vertices = tables.get("vertex", {})
    if not {"x", "y", "z"} <= vertices.keys():
        raise ValueError("expected an element 'vertex' with the properties x, y and z")
    kinds = {
        column.name: column.kind
        for element in elements
        if element.name == "vertex"
        for column in element.properties
    }
    return RawScan(
        _stacked(vertices, ("x", "y", "z")),
        _faces(tables.get("face", {})),
        _colours(vertices, kinds),
        _stacked(vertices, ("nx", "ny", "nz")) if {"nx", "ny", "nz"} <= vertices.keys() else None,
    )


def _stacked(columns: Columns, names: tuple[str, ...]) -> Float64[np.ndarray, "N c"]:
    with np.errstate(invalid="ignore"):  # signalling NaN: cleaning drops such points and says so
        return np.stack([columns[name].astype(np.float64) for name in names], axis=1)


def _colours(vertices: Columns, kinds: dict[str, str]) -> np.ndarray | None:
    for prefix in ("", "diffuse_"):
        names = tuple(prefix + name for name in ("red", "green", "blue"))
        if vertices.keys() >= set(names):
            table = _stacked(vertices, names)
            if kinds[names[0]] == "u1":
                return np.nan_to_num(table).clip(0, 255).astype(np.uint8)
            return eight_bit(table / 257.0 if kinds[names[0]] == "u2" else table)
    return None


def _faces(columns: Columns) -> np.ndarray:
    name = next((name for name in _INDEX_NAMES if name + "#" in columns), None)
    if name is None:
        return no_faces()
    return fans(indices(columns[name + "#"].astype(np.float64)), indices(columns[name].astype(np.float64)))


def _ascii_tables(elements: tuple[Element, ...], values: Float64[np.ndarray, " n"]) -> dict[str, Columns]:
    tables, position = {}, 0
    for element in elements:
        rows = values[position:]
        columns, used = _rows_of_one_width(element, rows) or _rows_of_any_width(element, rows)
        tables[element.name] = columns
        position += used
    return tables


def _rows_of_one_width(element: Element, values: np.ndarray) -> tuple[Columns, int] | None:
    """Columns of rows that all have the lengths of the first; None if they do not."""
    layout, width = [], 0
    for column in element.properties if element.count else ():
        length = 1
        if column.count_kind:
            if width >= len(values) or not 0 <= values[width] <= len(values):
                return None
            length = int(values[width])
            layout.append((column.name + "#", width, 1))
            width += 1
        layout.append((column.name, width, length))
        width += length
    if element.count * width > len(values):
        return None
    if width == 0:
        return {}, 0
    table = values[: element.count * width].reshape(element.count, width)
    columns = {}
    for name, begin, length in layout:
        block = table[:, begin : begin + length]
        if name.endswith("#") and (block != block[0]).any():
            return None
        columns[name] = block.ravel()
    return columns, element.count * width


def _rows_of_any_width(element: Element, values: np.ndarray) -> tuple[Columns, int]:
    parts: dict[str, list[np.ndarray]] = {}
    position = 0
    for _ in range(element.count):
        for column in element.properties:
            length = 1
            if column.count_kind:
                length = _list_length(column, values[position : position + 1], len(values) - position - 1)
                parts.setdefault(column.name + "#", []).append(values[position : position + 1])
                position += 1
            if position + length > len(values):
                raise ValueError(f"the file is cut off within the element '{element.name}'")
            parts.setdefault(column.name, []).append(values[position : position + length])
            position += length
    return {name: np.concatenate(part) for name, part in parts.items()}, position


def _list_length(column: Property, length: np.ndarray, left: int) -> int:
    if len(length) == 0 or not 0 <= length[0] <= left:
        raise ValueError(f"the list '{column.name}' does not fit: the file is cut off or damaged")
    return int(length[0])


def _binary_tables(elements: tuple[Element, ...], order: Encoding, body: memoryview) -> dict[str, Columns]:
    tables, position = {}, 0
    for element in elements:
        rest = body[position:]
        columns, used = _records_of_one_size(element, order, rest) or _records_of_any_size(
            element, order, rest
        )
        tables[element.name] = columns
        position += used
    return tables


def _records_of_one_size(element: Element, order: Encoding, body: memoryview) -> tuple[Columns, int] | None:
    """Columns of records that all have the list lengths of the first; None if they do not."""
    fields: list[tuple[str, str, tuple[int, ...]]] = []
    size = 0
    for column in element.properties if element.count else ():
        shape: tuple[int, ...] = ()
        if column.count_kind:
            kind = np.dtype(order + column.count_kind)
            if size + kind.itemsize > len(body):
                return None
            length = int(np.frombuffer(body, kind, 1, size)[0])
            if not 0 <= length <= len(body):
                return None
            fields.append((column.name + "#", kind.str, ()))
            size += kind.itemsize
            shape = (length,)
        fields.append((column.name, order + column.kind, shape))
        size += int(column.kind[1:]) * int(np.prod(shape))
    if element.count * size > len(body):
        return None
    if size == 0:
        return {}, 0
    records = np.frombuffer(body, np.dtype(fields), element.count)
    if any(name.endswith("#") and (records[name] != records[name][0]).any() for name, _, _ in fields):
        return None
    return {name: records[name].ravel() for name, _, _ in fields}, element.count * size


def _records_of_any_size(element: Element, order: Encoding, body: memoryview) -> tuple[Columns, int]:
    parts: dict[str, list[np.ndarray]] = {}
    position = 0
    for _ in range(element.count):
        for column in element.properties:
            length, kind = 1, np.dtype(order + column.kind)
            if column.count_kind:
                count_kind = np.dtype(order + column.count_kind)
                told = np.frombuffer(body[position : position + count_kind.itemsize], count_kind)
                length = _list_length(column, told, len(body) - position)
                parts.setdefault(column.name + "#", []).append(told)
                position += count_kind.itemsize
            if position + length * kind.itemsize > len(body):
                raise ValueError(f"the file is cut off within the element '{element.name}'")
            parts.setdefault(column.name, []).append(np.frombuffer(body, kind, length, position))
            position += length * kind.itemsize
    return {name: np.concatenate(part) for name, part in parts.items()}, position
