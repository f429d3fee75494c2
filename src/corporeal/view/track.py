"""A track as the page knows it: rows of its frames, vertices, and scans, whoever reads them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Float32, Int, UInt8


@dataclass(frozen=True)
class FrameRow:
    """What is known of a frame without opening anything.

    Attributes:
        name: of the frame.
        status: ok, doubtful or failed.
        reason: the sentence that explains the status; "" where all is well.
        s2m_mm: mean distance of the scan to the model; None where nothing was fitted.
        seen: (what, share that the scan confirms), for instance ("left hand", 0.93).
    """

    name: str
    status: str
    reason: str
    s2m_mm: float | None
    seen: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True, eq=False)
class ShownScan:
    """What is drawn of a scan, in metres in the scan's frame.

    Attributes:
        points: (N, 3), thinned; none where there is no scan.
        colours: (N, 3) by distance to the model.
        note: why there is no scan, or "".
    """

    points: Float32[np.ndarray, "N 3"]
    colours: UInt8[np.ndarray, "N 3"]
    note: str = ""

    @classmethod
    def missing(cls, note: str) -> ShownScan:
        """No scan, and why."""
        return cls(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint8), note)


@dataclass(frozen=True, eq=False)
class Stance:
    """How the person stands in the scans' frame when the track begins: unit vectors and metres.

    Attributes:
        up: (3,) the axis of the frame that comes closest to the person's up.
        front: (3,) where the person looks, level.
        centre: (3,) the middle of the person.
        floor: height of the lowest vertex along ``up``.
        size: greatest extent of the person along an axis.
    """

    up: Float[np.ndarray, "3"]
    front: Float[np.ndarray, "3"]
    centre: Float[np.ndarray, "3"]
    floor: float
    size: float


@runtime_checkable
class Track(Protocol):
    """One tracked sequence. ``vertices`` and ``scan`` are called in threads of their own."""

    @property
    def name(self) -> str:
        """Of the sequence."""

    @property
    def note(self) -> str:
        """What the user should know of the whole sequence, or ""."""

    @property
    def fps(self) -> float:
        """Frames per second."""

    def faces(self) -> Int[np.ndarray, "F 3"]:
        """Of the model."""

    @property
    def rows(self) -> Sequence[FrameRow]:
        """The frames that are there, in order; none where tracking has not come to the first."""

    def vertices(self, start: int, stop: int) -> Float32[np.ndarray, "n V 3"]:
        """The model in these frames, metres; it never raises: what cannot be read stands as before."""

    def scan(self, index: int) -> ShownScan:
        """The scan of a frame; it never raises: one that cannot be read has a note."""

    def stance(self) -> Stance:
        """How the person stands in the first frame that did not fail; needs a frame."""

    def release(self) -> None:
        """Another track is looked at: let go of what takes memory; it is read again when it is needed."""

    def refresh(self) -> bool:
        """Read what has been written since; whether frames that were there have changed."""


def stance_of(
    vertices: Float32[np.ndarray, "V 3"], up: Float[np.ndarray, "3"], front: Float[np.ndarray, "3"]
) -> Stance:
    """How a person stands, from a posed model and the directions of its root.

    Args:
        vertices: of the model in the first good frame, metres.
        up: (3,) the root's y axis in the scans' frame.
        front: (3,) its z axis.
    """
    axis = int(np.abs(up).argmax())
    level_up = np.zeros(3)
    level_up[axis] = np.sign(up[axis]) or 1.0
    level = front - (front @ level_up) * level_up
    if np.linalg.norm(level) < 1e-6:
        level = np.roll(level_up, 1)
    heights = vertices.astype(np.float64) @ level_up
    centre = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0)).astype(np.float64)
    size = float(np.ptp(vertices, axis=0).max())
    return Stance(level_up, level / np.linalg.norm(level), centre, float(heights.min()), size)


def problem_stretches(rows: Sequence[FrameRow]) -> list[tuple[int, int]]:
    """(first, last) of frames that follow one another, are not ok, and have the same status and reason."""
    found: list[tuple[int, int]] = []
    for index, row in enumerate(rows):
        if row.status == "ok":
            continue
        before = rows[found[-1][1]] if found and found[-1][1] == index - 1 else None
        if before is not None and (before.status, before.reason) == (row.status, row.reason):
            found[-1] = (found[-1][0], index)
        else:
            found.append((index, index))
    return found
