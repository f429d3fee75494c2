"""The one record of a capture: points in metres, with all that is known of where they came from."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Float64, Int64, UInt8

UnitName = Literal["m", "cm", "mm", "free"]


@dataclass(frozen=True)
class Unit:
    """The unit of a scan's file.

    Attributes:
        name: "m", "cm", "mm", or "free" where the file has no unit and the scale is an estimate.
        metres_per_unit: what a coordinate of the file is multiplied with to become metres.
    """

    name: UnitName
    metres_per_unit: float

    def __post_init__(self) -> None:
        if not (np.isfinite(self.metres_per_unit) and self.metres_per_unit > 0):
            raise ValueError(f"metres_per_unit: expected a positive number, got {self.metres_per_unit}")


@dataclass(frozen=True, eq=False)
class Scan:
    """A checked and cleaned capture, in its own frame: scaled to metres, never moved or turned.

    N points, M faces.

    Attributes:
        name: what results are called after; the stem of the file's name.
        points: (N, 3) metres, finite.
        faces: (M, 3) indices of points, counter-clockwise from outside; M = 0 for a point cloud.
        normals: (N, 3) outward, of unit length; zero for a point that lies on no face with an area.
        colours: (N, 3) red, green, blue, 8 bit; or None.
        unit: the unit of the file, or the estimate of it.
        source: name of the file that was read.
        repairs: sentences that say what was dropped, mended or guessed on the way from the file.
    """

    name: str
    points: Float64[np.ndarray, "N 3"]
    faces: Int64[np.ndarray, "M 3"]
    normals: Float64[np.ndarray, "N 3"]
    colours: UInt8[np.ndarray, "N 3"] | None
    unit: Unit
    source: str = ""
    repairs: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if len(self.points) == 0:
            raise ValueError("points: a scan needs at least one point")
        if not np.isfinite(self.points).all():
            raise ValueError("points: expected finite coordinates; drop the others before building a Scan")
        if self.normals.shape != self.points.shape:
            raise ValueError(f"normals: expected {self.points.shape}, got {self.normals.shape}")
        if self.colours is not None and self.colours.shape != self.points.shape:
            raise ValueError(f"colours: expected {self.points.shape}, got {self.colours.shape}")
        if len(self.faces) and not 0 <= self.faces.min() <= self.faces.max() < len(self.points):
            raise ValueError(f"faces: expected indices from 0 to {len(self.points) - 1}")

    @property
    def is_point_cloud(self) -> bool:
        """Whether the scan has points only, and no faces."""
        return len(self.faces) == 0

    @property
    def diagonal(self) -> float:
        """Length of the diagonal of the axis-aligned bounding box, metres."""
        return float(np.linalg.norm(np.ptp(self.points, axis=0)))

    def in_own_unit(self, points_m: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
        """Points given in metres, in the unit of the scan's file; the frame is the same."""
        return points_m / self.unit.metres_per_unit

    def with_scale(self, metres_per_unit: float) -> Scan:
        """The same file read with another scale, whose unit is then "free".

        Args:
            metres_per_unit: the new estimate, for instance from a fit; positive.
        """
        unit = Unit("free", metres_per_unit)
        ratio = metres_per_unit / self.unit.metres_per_unit
        return dataclasses.replace(self, points=self.points * ratio, unit=unit)

    def with_repair(self, sentence: str) -> Scan:
        """The same scan with one more sentence in ``repairs``."""
        return dataclasses.replace(self, repairs=(*self.repairs, sentence))

    def subset(self, mask: Bool[np.ndarray, " N"]) -> Scan:
        """The points where ``mask`` is true, in their order, and the faces that keep all three corners.

        Normals stay those of the whole scan. Raises ``ValueError`` if nothing is left.
        """
        if not mask.any():
            raise ValueError("mask: no point of the scan is left")
        renumbered = np.cumsum(mask) - 1
        whole = mask[self.faces].all(axis=1)
        return dataclasses.replace(
            self,
            points=self.points[mask],
            faces=renumbered[self.faces[whole]].astype(np.int64),
            normals=self.normals[mask],
            colours=None if self.colours is None else self.colours[mask],
        )
