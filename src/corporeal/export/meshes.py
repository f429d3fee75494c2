"""Surfaces and point clouds as PLY and OBJ."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int, UInt8

from corporeal.atomic import write_bytes


def write_ply(
    path: Path | str, vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"] | None = None, *,
    colours: UInt8[np.ndarray, "V 3"] | None = None,
    properties: Mapping[str, Float[np.ndarray, " V"]] | None = None, comments: tuple[str, ...] = (),
) -> None:  # fmt: skip
    """Write a binary little-endian PLY; coordinates keep their precision (float or double).

    Args:
        path: the file; its folder is made if it is missing.
        vertices: in any unit; the file does not say which (a comment can).
        faces: corner indices, or None for a point cloud.
        colours: red, green, blue per vertex.
        properties: further numbers per vertex by name, for instance ``{"error_mm": ...}``, written as float.
        comments: lines for the header.

    Raises:
        ValueError: a name or comment that a PLY header cannot hold, coordinates that are not finite, or face
            indices outside the vertices.
    """
    _check_mesh(vertices, faces)
    coordinate = "<f4" if vertices.dtype == np.float32 else "<f8"
    fields: list[tuple[str, str, np.ndarray]] = [
        (axis, coordinate, vertices[:, column]) for column, axis in enumerate("xyz")
    ]
    if colours is not None:
        fields += [(name, "u1", colours[:, column]) for column, name in enumerate(("red", "green", "blue"))]
    fields += [(name, "<f4", numbers) for name, numbers in (properties or {}).items()]
    lines = ["ply", "format binary_little_endian 1.0", *(f"comment {_line(line)}" for line in comments)]
    lines += [f"element vertex {len(vertices)}"]
    lines += [f"property {_PLY_TYPES[kind]} {_word(name)}" for name, kind, _ in fields]
    lines += [] if faces is None else [f"element face {len(faces)}", "property list uchar int vertex_indices"]
    table = np.empty(len(vertices), dtype=[(name, kind) for name, kind, _ in fields])
    for name, _, numbers in fields:
        table[name] = numbers
    content = "\n".join([*lines, "end_header\n"]).encode("ascii", "replace") + table.tobytes()
    write_bytes(path, content + (b"" if faces is None else _ply_faces(faces)))


def write_obj(
    path: Path | str, vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"] | None = None, *,
    comments: tuple[str, ...] = (),
) -> None:  # fmt: skip
    """Write a Wavefront OBJ; numbers are written so that reading gives the same bits back.

    Raises:
        ValueError: coordinates that are not finite, face indices outside the vertices, a comment of more than
            one line.
    """
    _check_mesh(vertices, faces)
    lines = [f"# {_line(line)}" for line in comments]
    lines += [f"v {x!s} {y!s} {z!s}" for x, y, z in vertices]
    if faces is not None:
        lines += [f"f {a} {b} {c}" for a, b, c in faces + 1]
    write_bytes(path, ("\n".join(lines) + "\n").encode())


_PLY_TYPES = {"<f4": "float", "<f8": "double", "u1": "uchar"}


def _ply_faces(faces: Int[np.ndarray, "F 3"]) -> bytes:
    table = np.empty(len(faces), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    table["count"], table["corners"] = 3, faces
    return table.tobytes()


def _check_mesh(vertices: np.ndarray, faces: np.ndarray | None) -> None:
    if not np.isfinite(vertices).all():
        raise ValueError("vertices: hold NaN or infinite numbers")
    if faces is not None and faces.size and (faces.min() < 0 or faces.max() >= len(vertices)):
        raise ValueError(f"faces: indices must lie in 0..{len(vertices) - 1}")


def _line(text: str) -> str:
    if "\n" in text or "\r" in text:
        raise ValueError(f"comments: {text!r} must be one line")
    return text


def _word(name: str) -> str:
    if not name.isascii() or not name.isidentifier():
        raise ValueError(f"properties: {name!r} must be one word of letters, digits and underscores")
    return name
