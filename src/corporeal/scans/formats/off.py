"""OFF, with vertex colours and normals (COFF, NOFF, CNOFF).

Own reader: trimesh drops the colours of a COFF file without a word.
"""

from __future__ import annotations

import re

import numpy as np

from corporeal.scans.raw import RawScan, eight_bit, fans, indices, numbers

_HEADER = re.compile(rb"\s*(ST)?(C)?(N)?(4)?(n)?OFF\b([^\n]*)\n?")


def parse_off(data: bytes) -> RawScan:
    """The mesh of an ASCII OFF file.

    Raises:
        ValueError: the text is no OFF file, or its counts, numbers or indices are wrong.
    """
    text = re.sub(rb"#[^\n]*", b"", data.replace(b"\r\n", b"\n").replace(b"\r", b"\n"))
    header = _HEADER.match(text)
    if header is None:
        raise ValueError("expected 'OFF', 'COFF', 'NOFF' or 'CNOFF' as the first word")
    textured, coloured, has_normals, four, general, rest = header.groups()
    if textured or four or general or rest.strip().upper().startswith(b"BINARY"):
        raise ValueError("4D, textured and binary OFF are not read; save it as PLY or as plain OFF or COFF")
    lines = [line for line in (rest + b"\n" + text[header.end() :]).split(b"\n") if line.strip()]
    if not lines:
        raise ValueError("the line with the numbers of vertices and faces is missing")
    vertex_count, face_count = _counts(lines[0], len(lines) - 1)
    rows = [line.split() for line in lines[1 : 1 + vertex_count]]
    points, normals, colours = _vertices(rows, bool(has_normals), bool(coloured))
    faces = _faces([line.split() for line in lines[1 + vertex_count : 1 + vertex_count + face_count]])
    return RawScan(points, faces, colours, normals)


def _counts(line: bytes, lines_left: int) -> tuple[int, int]:
    words = line.split()
    if len(words) < 2 or not (words[0].isdigit() and words[1].isdigit()):
        raise ValueError(f"expected the numbers of vertices, faces and edges, found {line[:60]!r}")
    vertex_count, face_count = int(words[0]), int(words[1])
    if vertex_count + face_count > lines_left:
        raise ValueError(
            f"the header says {vertex_count} vertices and {face_count} faces, but only {lines_left} lines "
            "follow: the file is cut off or its header is wrong"
        )
    return vertex_count, face_count


def _vertices(
    rows: list[list[bytes]], has_normals: bool, coloured: bool
) -> tuple[np.ndarray, np.ndarray | None, np.ndarray | None]:
    """Points, normals and colours; all vertex lines must have the same number of columns."""
    width = len(rows[0]) if rows else 3
    needed = 3 + 3 * has_normals + 3 * coloured
    if width < needed or any(len(row) != width for row in rows):
        raise ValueError(f"expected at least {needed} numbers in every vertex line, and the same in all")
    table = numbers([word for row in rows for word in row], "vertices").reshape(len(rows), width)
    normals = np.ascontiguousarray(table[:, 3:6]) if has_normals else None
    after = 6 if has_normals else 3
    # Some writers add colours under a plain OFF header: three or four more columns can be nothing else.
    has_colours = coloured or (not has_normals and width in (6, 7))
    return (
        np.ascontiguousarray(table[:, :3]),
        normals,
        eight_bit(table[:, after:]) if has_colours and len(rows) else None,
    )


def _faces(rows: list[list[bytes]]) -> np.ndarray:
    sizes = indices(numbers([row[0] for row in rows], "faces"))
    for row, size in zip(rows, sizes, strict=True):
        if not 3 <= size <= len(row) - 1:
            raise ValueError(f"a face line with {len(row) - 1} numbers says it has {size} corners")
    corners = [word for row, size in zip(rows, sizes, strict=True) for word in row[1 : size + 1]]
    return fans(sizes, indices(numbers(corners, "faces")))
