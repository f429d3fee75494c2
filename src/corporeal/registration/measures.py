"""Scan-to-mesh distance, with the region that is not scored named."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from corporeal.geometry.closest_points import ClosestPoints
from corporeal.model.jacobian import Evaluated
from corporeal.model.surface_model import CutPlane
from corporeal.terms.scan_to_surface import MovingSurface

_BOUNDARY_MARGIN = 1e-3


@dataclass(frozen=True, eq=False)
class SurfaceDistances:
    """Distances of scan points to a surface.

    Attributes:
        metres: (N,) distance of every scan point.
        beyond_cut: (N,) points on the model's side of the cut plane (all, where there is none).
        scored: (N,) of those, the points whose closest point is farther than 1 mm from the open boundary.
    """

    metres: Float[np.ndarray, " N"]
    beyond_cut: Bool[np.ndarray, " N"]
    scored: Bool[np.ndarray, " N"]

    @property
    def scored_share(self) -> float:
        """Share of the points beyond the cut plane that are scored; 0 where there are none."""
        beyond = int(self.beyond_cut.sum())
        return float(self.scored.sum()) / beyond if beyond else 0.0

    def summary_mm(self) -> dict[str, float]:
        """Mean, median, 95th percentile in mm, share under 1 mm, and the share of points scored."""
        mm = 1e3 * self.metres[self.scored]
        if not len(mm):
            empty = float("nan")
            return {"mean": empty, "median": empty, "p95": empty, "under_1mm": empty, "scored_share": 0.0}
        return {
            "mean": float(mm.mean()),
            "median": float(np.median(mm)),
            "p95": float(np.percentile(mm, 95)),
            "under_1mm": float((mm < 1).mean()),
            "scored_share": self.scored_share,
        }


def scan_to_mesh(
    surface: MovingSurface,
    vertices: Float[np.ndarray, "V 3"],
    points: Float[np.ndarray, "N 3"],
    beyond_cut: Bool[np.ndarray, " N"],
) -> SurfaceDistances:
    """Distances of all scan points to a surface, metres.

    Scored are the points on the hand's side of the cut plane except those whose closest point lies within
    1 mm of the open boundary: there the surface ends and the scan goes on.
    """
    closest = surface.closest(vertices, points, None)
    near = _near_boundary(surface, vertices, closest)
    return SurfaceDistances(np.sqrt(closest.squared_distances), beyond_cut, beyond_cut & ~near)


def beyond_cut(
    points: Float[np.ndarray, "N 3"], cut: CutPlane | None, posed: Evaluated, margin: float = 0.0
) -> Bool[np.ndarray, " N"]:
    """Points on the side of the cut plane that the model keeps, ``margin`` metres before it included."""
    if cut is None:
        return np.ones(len(points), dtype=bool)
    T_world_joint = posed.T_world_joint[cut.joint]
    point = T_world_joint[:3, :3] @ cut.point + T_world_joint[:3, 3]
    normal = T_world_joint[:3, :3] @ cut.normal
    return (points - point) @ normal > -margin


def _near_boundary(
    surface: MovingSurface, vertices: np.ndarray, closest: ClosestPoints
) -> Bool[np.ndarray, " N"]:
    segments = vertices[surface.boundary]
    if not len(segments):
        return np.zeros(len(closest.points), dtype=bool)
    # Only points near the loop's box can be within the margin; the rest skip the N x E distances.
    low, high = segments.min((0, 1)) - _BOUNDARY_MARGIN, segments.max((0, 1)) + _BOUNDARY_MARGIN
    candidates = np.flatnonzero(((closest.points > low) & (closest.points < high)).all(axis=1))
    start, along = segments[:, 0], segments[:, 1] - segments[:, 0]
    length = np.maximum(np.einsum("ea,ea->e", along, along), 1e-30)
    near = np.zeros(len(closest.points), dtype=bool)
    for chunk in np.array_split(candidates, max(1, len(candidates) // 2000)):
        offset = closest.points[chunk, None] - start[None]
        share = np.clip(np.einsum("nea,ea->ne", offset, along) / length, 0, 1)
        gap = offset - share[..., None] * along
        near[chunk] = (np.einsum("nea,nea->ne", gap, gap) < _BOUNDARY_MARGIN**2).any(axis=1)
    return near
