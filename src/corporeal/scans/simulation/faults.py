"""Scans that are bad on purpose, as some of every session are."""

from __future__ import annotations

import zlib
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from corporeal.scans.simulation.scanner import RawCapture

Fault = Literal["", "moved", "half", "empty", "nan", "truncated"]
FAULTS: tuple[Fault, ...] = ("moved", "half", "empty", "nan", "truncated")
_GHOST = (8e-3, 20e-3)  # metres the hand moved during the capture
_PLY_SIZES = {b"float": 4, b"float32": 4, b"uchar": 1, b"uint8": 1}
_GHOST_TURN = np.deg2rad(12.0)


def choose_fault(name: str, seed: int, one_in: int) -> Fault:
    """The fault of a scan, "" for most; it follows from the scan's name and the session's seed."""
    if one_in < 1:
        return ""
    draw = np.random.default_rng([seed, 4, zlib.crc32(name.encode())])
    return FAULTS[draw.integers(len(FAULTS))] if draw.integers(one_in) == 0 else ""


def spoil(capture: RawCapture, fault: Fault, generator: np.random.Generator) -> RawCapture:
    """The capture with its fault; "nan" and "truncated" are done to the file."""
    if fault == "moved":
        return _moved(capture, generator)
    if fault == "half":
        return _half(capture, generator)
    if fault == "empty":
        return _kept(capture, np.zeros(0, dtype=np.int64), capture.faces[:0])
    return capture


def spoiled_bytes(content: bytes, fault: Fault) -> bytes:
    """A binary PLY's content with its fault: cut in its middle, or with coordinates that are no numbers."""
    if fault == "truncated":
        return content[: len(content) // 2]
    if fault == "nan":
        return _without_numbers(content)
    return content


def _without_numbers(content: bytes) -> bytes:
    """Coordinates (the first three properties, floats) of all vertices replaced; no writer would do it."""
    begin = content.index(b"end_header\n") + len(b"end_header\n")
    vertex = content[:begin].split(b"element vertex ")[1].split(b"element")[0].split(b"\n")
    sizes = [_PLY_SIZES[line.split()[1]] for line in vertex[1:] if line.startswith(b"property")]
    count, stride = int(vertex[0]), sum(sizes)
    block = (
        np.frombuffer(content, dtype=np.uint8, count=count * stride, offset=begin)
        .reshape(count, stride)
        .copy()
    )
    block[:, :12] = np.frombuffer(np.full(3, np.nan, dtype="<f4").tobytes(), dtype=np.uint8)
    return content[:begin] + block.tobytes() + content[begin + count * stride :]


def _moved(capture: RawCapture, generator: np.random.Generator) -> RawCapture:
    """The hand moved: what some units saw lies beside what the others saw."""
    direction = generator.normal(size=3)
    direction /= np.linalg.norm(direction)
    centre = capture.points.mean(0)
    late = (capture.points - centre) @ direction > 0
    turn = Rotation.from_rotvec(_GHOST_TURN * generator.normal(size=3) / np.sqrt(3)).as_matrix()
    step = generator.normal(size=3)
    step *= generator.uniform(*_GHOST) / np.linalg.norm(step)
    ghost = capture.points.copy()
    ghost[late] = (capture.points[late] - centre) @ turn.T + centre + step
    whole = late[capture.faces].all(1) | ~late[capture.faces].any(1)
    return RawCapture(ghost, capture.faces[whole], capture.colours, capture.clean, capture.samples)


def _half(capture: RawCapture, generator: np.random.Generator) -> RawCapture:
    """Half of the hand was not captured: the upper half (the fingers), or one side of it."""
    direction = np.array([0.0, 0.0, 1.0]) if generator.random() < 0.5 else generator.normal(size=3)
    along = capture.points @ direction
    kept = along < np.median(along)
    number = np.cumsum(kept) - 1
    faces = number[capture.faces[kept[capture.faces].all(1)]]
    return _kept(capture, kept, faces)


def _kept(capture: RawCapture, kept: np.ndarray, faces: np.ndarray) -> RawCapture:
    colours, clean, samples = (array[kept] for array in (capture.colours, capture.clean, capture.samples))
    return RawCapture(capture.points[kept], faces, colours, clean, samples)
