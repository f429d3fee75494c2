"""Distances between scan and mesh both ways, with the regions that are not scored named."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from corporeal.geometry.closest_points import ClosestPoints
from corporeal.geometry.normals import areas_around, face_normals, vertex_normals
from corporeal.model.jacobian import Evaluated
from corporeal.model.surface_model import CutPlane
from corporeal.terms.scan_to_surface import MovingSurface
from corporeal.terms.surface_to_scan import ScanSurface

_BOUNDARY_MARGIN = 1e-3
# A registered vertex farther from the scan has no scan beside it. Noise, meshing and the coarser copy of the
# scan that is asked stay below a third of it.
_FAR = 3e-3
_SAME_SKIN = 0.3


@dataclass(frozen=True, eq=False)
class SurfaceDistances:
    """Distances of scan points to a surface.

    Attributes:
        metres: (N,) distance of every scan point.
        beyond_cut: (N,) points on the model's side of the cut plane (all, where there is none).
        scored: (N,) of those, the points whose closest point is farther than 1 mm from the open boundary.
        closest: the closest points themselves.
        cosines: (N,) of the angle between a point's normal and the surface's, or None without normals.
    """

    metres: Float[np.ndarray, " N"]
    beyond_cut: Bool[np.ndarray, " N"]
    scored: Bool[np.ndarray, " N"]
    closest: ClosestPoints
    cosines: Float[np.ndarray, " N"] | None = None

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
    normals: Float[np.ndarray, "N 3"] | None = None,
) -> SurfaceDistances:
    """Distances of all scan points to a surface, metres.

    Scored are the points on the hand's side of the cut plane except those whose closest point lies within
    1 mm of the open boundary: there the surface ends and the scan goes on.
    """
    closest = surface.closest(vertices, points, None)
    near = _near_boundary(surface, vertices, closest)
    cosines = None
    if normals is not None:
        cosines = np.einsum("na,na->n", face_normals(vertices, surface.faces)[closest.faces], normals)
    return SurfaceDistances(closest.distances, beyond_cut, beyond_cut & ~near, closest, cosines)


def mean_offsets(
    distances: SurfaceDistances,
    points: Float[np.ndarray, "N 3"],
    faces: Int[np.ndarray, "F 3"],
    vertex_count: int,
) -> tuple[Float[np.ndarray, "V 3"], Float[np.ndarray, " V"]]:
    """Mean offset from the mesh to the scored scan points around each vertex, metres, and how many there are.

    Points count by their barycentric weights. Noise averages out, and what is left is scan that the mesh does
    not follow, whatever the scanner.
    """
    scored, closest = distances.scored, distances.closest
    corners, shares = faces[closest.faces[scored]].ravel(), closest.barycentric[scored]
    offsets = (points - closest.points)[scored]
    counts = np.bincount(corners, shares.ravel(), minlength=vertex_count)
    means = np.zeros((vertex_count, 3))
    for axis in range(3):
        weighted = (shares * offsets[:, axis, None]).ravel()
        means[:, axis] = np.bincount(corners, weighted, minlength=vertex_count) / np.maximum(counts, 1e-9)
    return means, counts


@dataclass(frozen=True)
class SurfaceCoverage:
    """A mesh measured against a scan with holes; shares of the mesh's area.

    Attributes:
        far_share: vertices more than 3 mm from a scan that was seen there: its closest point lies within
            the scan's surface, and faces the same way.
        hole_share: vertices more than 3 mm from the scan where nothing was seen: the closest point lies at
            the rim of a hole, or on skin that faces elsewhere.
    """

    far_share: float
    hole_share: float


def surface_coverage(
    vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], scan: ScanSurface
) -> SurfaceCoverage:
    """Which part of a mesh (metres) the scan confirms, which it contradicts, and of which it says nothing."""
    closest = scan.tree.closest(vertices)
    areas = areas_around(vertices, faces)
    cosines = np.einsum("va,va->v", vertex_normals(vertices, faces), scan.normals[closest.faces])
    away = closest.distances > _FAR
    seen = ~_at_rim(scan)[closest.faces] & (cosines > _SAME_SKIN)
    total = max(float(areas.sum()), 1e-30)
    return SurfaceCoverage(float(areas[away & seen].sum()) / total, float(areas[away & ~seen].sum()) / total)


def _at_rim(scan: ScanSurface) -> Bool[np.ndarray, " M"]:
    """Faces with a corner on an open border; a tie between faces at a corner must not decide."""
    faces = scan.tree.faces
    rim = np.zeros(int(faces.max()) + 1, dtype=bool)
    for corner in range(3):
        open_here = faces[scan.boundary_sides[:, corner]]
        rim[np.delete(open_here, corner, axis=1)] = True
    return rim[faces].any(axis=1)


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
    # Who is near a segment is near its middle: most of the box is not.
    reach = _BOUNDARY_MARGIN + 0.5 * float(np.linalg.norm(along, axis=1).max())
    middles = cKDTree(segments.mean(axis=1))
    away, _ = middles.query(closest.points[candidates], distance_upper_bound=1.001 * reach)
    candidates = candidates[np.isfinite(away)]
    length = np.maximum(np.einsum("ea,ea->e", along, along), 1e-30)
    near = np.zeros(len(closest.points), dtype=bool)
    for chunk in np.array_split(candidates, max(1, len(candidates) // 2000)):
        offset = closest.points[chunk, None] - start[None]
        share = np.clip(np.einsum("nea,ea->ne", offset, along) / length, 0, 1)
        gap = offset - share[..., None] * along
        near[chunk] = (np.einsum("nea,nea->ne", gap, gap) < _BOUNDARY_MARGIN**2).any(axis=1)
    return near
