"""What a file held, before it is cleaned: the common answer of all readers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float64, Int, Int64, UInt8


@dataclass(frozen=True, eq=False)
class RawScan:
    """Points and triangles as they stand in a file; coordinates may be anything, indices are in range.

    Attributes:
        points: (N, 3) in the file's unit; may hold NaN, infinities and wild values.
        faces: (M, 3) indices of points; M = 0 for a point cloud.
        colours: (N, 3) 8-bit red, green, blue; or None.
        normals: (N, 3) as the file gives them, of any length; or None.
        notes: sentences on what the reader had to decide.
    """

    points: Float64[np.ndarray, "N 3"]
    faces: Int64[np.ndarray, "M 3"]
    colours: UInt8[np.ndarray, "N 3"] | None = None
    normals: Float64[np.ndarray, "N 3"] | None = None
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        count = len(self.points)
        if len(self.faces) == 0:
            return
        lowest, highest = int(self.faces.min()), int(self.faces.max())
        if lowest < 0 or highest >= count:
            wrong = lowest if lowest < 0 else highest
            raise ValueError(f"a face refers to vertex {wrong}, but the file has vertices 0 to {count - 1}")


def no_faces() -> Int64[np.ndarray, "0 3"]:
    """The faces of a point cloud."""
    return np.zeros((0, 3), dtype=np.int64)


def fans(
    corner_counts: Int[np.ndarray, " polygons"], corners: Int[np.ndarray, " corners"]
) -> Int64[np.ndarray, "M 3"]:
    """Triangles of polygons, each cut into a fan about its first corner.

    Args:
        corner_counts: number of corners of every polygon.
        corners: the corners of all polygons, one polygon after the other.

    Raises:
        ValueError: a polygon has fewer than three corners.
    """
    if len(corner_counts) == 0:
        return no_faces()
    if corner_counts.min() < 3:
        raise ValueError(f"a face has {corner_counts.min()} corners; expected at least 3")
    triangles = corner_counts.astype(np.int64) - 2
    polygon = np.repeat(np.arange(len(corner_counts)), triangles)
    begin = (np.cumsum(corner_counts) - corner_counts).astype(np.int64)[polygon]
    step = np.arange(len(polygon)) - np.repeat(np.cumsum(triangles) - triangles, triangles)
    indices = np.stack([begin, begin + step + 1, begin + step + 2], axis=1)
    return corners.astype(np.int64)[indices]


def eight_bit(colours: Float[np.ndarray, "N c"]) -> UInt8[np.ndarray, "N 3"]:
    """The first three channels as 8-bit numbers; channels that nowhere exceed 1 are taken as 0..1."""
    channels = np.nan_to_num(colours[:, :3])
    scale = 255.0 if channels.max(initial=0) <= 1 else 1.0
    return np.clip(np.rint(channels * scale), 0, 255).astype(np.uint8)


def numbers(tokens: list[bytes], what: str) -> Float64[np.ndarray, " n"]:
    """Tokens of a text file as numbers; ``ValueError`` names ``what`` they are of and the first wrong one."""
    try:
        return np.fromiter(map(float, tokens), dtype=np.float64, count=len(tokens))
    except ValueError as error:
        raise ValueError(f"{what}: {error}") from None


def indices(values: Float64[np.ndarray, " n"]) -> Int64[np.ndarray, " n"]:
    """Numbers read from text as indices; ``ValueError`` if one is no whole number below 2^53."""
    if not (
        np.isfinite(values).all() and (np.abs(values) < 2**53).all() and (values == np.rint(values)).all()
    ):
        raise ValueError("a face has an index that is no whole number")
    return values.astype(np.int64)
