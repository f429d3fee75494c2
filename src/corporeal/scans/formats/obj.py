"""Wavefront OBJ: vertices with or without colour, and polygons.

Own reader: trimesh splits vertices at texture seams, which cleaning would have to weld again, and takes the
index 0, which the format does not have, for the first vertex. Materials and textures are not read.
"""

from __future__ import annotations

import re

import numpy as np

from corporeal.scans.raw import RawScan, eight_bit, fans, indices, no_faces, numbers

_VERTEX = re.compile(rb"^[ \t]*v[ \t]+([^\n#]*)", re.MULTILINE)
_FACE = re.compile(rb"^[ \t]*f[ \t]+([^\n#]*)", re.MULTILINE)


def parse_obj(data: bytes) -> RawScan:
    """The mesh of an OBJ file, all objects and groups together; without faces it is a point cloud.

    Raises:
        ValueError: there are no vertices, or a line holds wrong numbers.
    """
    text = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n").replace(b"\\\n", b" ")
    vertex_lines = list(_VERTEX.finditer(text))
    if not vertex_lines:
        raise ValueError("expected lines that begin with 'v'; found none")
    points, colours = _vertices([line.group(1).split() for line in vertex_lines])
    face_lines = list(_FACE.finditer(text))
    if not face_lines:
        return RawScan(points, no_faces(), colours)
    corners = [[word.split(b"/", 1)[0] for word in line.group(1).split()] for line in face_lines]
    sizes = np.array([len(row) for row in corners])
    index = indices(numbers([word for row in corners for word in row], "faces"))
    # A negative index counts back from the last vertex that stands before its face.
    begins = np.array([line.start() for line in vertex_lines])
    before = np.searchsorted(begins, np.array([line.start() for line in face_lines]))
    absolute = np.where(index > 0, index - 1, index + np.repeat(before, sizes))
    if (index == 0).any() or absolute.min(initial=0) < 0:
        raise ValueError("a face refers to a vertex that does not exist; indices begin with 1, or with -1")
    return RawScan(points, fans(sizes, absolute), colours)


def _vertices(rows: list[list[bytes]]) -> tuple[np.ndarray, np.ndarray | None]:
    """Points, and colours where every line has them: x y z, x y z w, x y z r g b or x y z r g b a."""
    width = len(rows[0])
    if width not in (3, 4, 6, 7) or any(len(row) != width for row in rows):
        raise ValueError("expected 3 coordinates, or these and a colour, in every line that begins with 'v'")
    table = numbers([word for row in rows for word in row], "v").reshape(len(rows), width)
    colours = eight_bit(table[:, 3:]) if width >= 6 else None
    return np.ascontiguousarray(table[:, :3]), colours
