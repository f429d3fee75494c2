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
_GHOST_TURN = np.deg2rad(12.0)


def choose_fault(name: str, seed: int, one_in: int) -> Fault:
    """The fault of a scan, "" for most; it follows from the scan's name and the session's seed."""
    if one_in < 1:
        return ""
    draw = np.random.default_rng([seed, 4, zlib.crc32(name.encode())])
    return FAULTS[draw.integers(len(FAULTS))] if draw.integers(one_in) == 0 else ""


def spoil(capture: RawCapture, fault: Fault, generator: np.random.Generator) -> RawCapture:
    """The capture with its fault; "truncated" is done to the file."""
    if fault == "moved":
        return _moved(capture, generator)
    if fault == "half":
        return _half(capture, generator)
    if fault == "empty":
        return RawCapture(capture.points[:0], capture.faces[:0], capture.colours[:0], capture.clean[:0])
    if fault == "nan":
        return RawCapture(np.full_like(capture.points, np.nan), capture.faces, capture.colours, capture.clean)
    return capture


def spoiled_bytes(content: bytes, fault: Fault) -> bytes:
    """A file's content with its fault."""
    return content[: len(content) // 2] if fault == "truncated" else content


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
    return RawCapture(ghost, capture.faces[whole], capture.colours, capture.clean)


def _half(capture: RawCapture, generator: np.random.Generator) -> RawCapture:
    """Half of the hand was not captured: the upper half (the fingers), or one side of it."""
    direction = np.array([0.0, 0.0, 1.0]) if generator.random() < 0.5 else generator.normal(size=3)
    along = capture.points @ direction
    kept = along < np.median(along)
    number = np.cumsum(kept) - 1
    faces = number[capture.faces[kept[capture.faces].all(1)]]
    return RawCapture(capture.points[kept], faces, capture.colours[kept], capture.clean[kept])
