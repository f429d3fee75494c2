"""How far the parts of a surface pass through one another: fingers through fingers, thumb through palm."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float, Int
from scipy.sparse import csgraph

from corporeal.geometry import winding_kernels
from corporeal.geometry.closest_points import SurfaceTree
from corporeal.geometry.normals import face_normals
from corporeal.geometry.topology import (
    boundary_loops,
    capped_by_fans,
    open_sides,
    remove_unreferenced,
    unique_edges,
)

BORDER = 0.01
"""Vertices within this distance of another part along the surface (metres) are not held against that part.

Where two parts meet, skin folds and the cap of the one may bulge into the other; no finger has passed through
anything there.
"""


@dataclass(frozen=True, eq=False)
class PartPenetration:
    """The vertices that lie inside another part, N of them; one that lies inside two parts stands twice.

    Attributes:
        vertices: (N,) vertex indices.
        own_parts: (N,) the part that the vertex belongs to.
        other_parts: (N,) the part that it lies inside.
        depths: (N,) distance to the other part's own surface, in the unit of the vertices, metres.
        faces: (N,) the face of the other part where that surface is closest.
        barycentric: (N, 3) weights of that closest point.
    """

    vertices: Int[np.ndarray, " N"]
    own_parts: Int[np.ndarray, " N"]
    other_parts: Int[np.ndarray, " N"]
    depths: Float[np.ndarray, " N"]
    faces: Int[np.ndarray, " N"]
    barycentric: Float[np.ndarray, "N 3"]

    @property
    def deepest(self) -> float:
        """The largest depth; 0 where no part passes through another."""
        return float(self.depths.max(initial=0.0))

    @property
    def by_pair(self) -> dict[tuple[int, int], float]:
        """Largest depth for every pair of parts that touch, the lower label first, the deepest pair first."""
        pairs: dict[tuple[int, int], float] = {}
        for own, other, depth in zip(self.own_parts, self.other_parts, self.depths, strict=True):
            pair = (int(min(own, other)), int(max(own, other)))
            pairs[pair] = max(pairs.get(pair, 0.0), float(depth))
        return dict(sorted(pairs.items(), key=lambda item: -item[1]))


def winding_numbers(
    points: Float[np.ndarray, "N 3"], vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]
) -> Float[np.ndarray, " N"]:
    """Generalised winding number of a surface at each point (Jacobson, Kavan and Sorkine-Hornung 2013).

    1 inside and 0 outside of a closed surface with faces counter-clockwise from outside, 2 where two closed
    surfaces overlap, in between near the holes of an open one. Exact, at a cost of N times F.
    """
    return winding_kernels.winding_numbers(
        np.ascontiguousarray(points, dtype=np.float64),
        np.ascontiguousarray(vertices, dtype=np.float64),
        np.ascontiguousarray(faces, dtype=np.int64),
    )


def part_penetration(
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    part_of_vertex: Int[np.ndarray, " V"],
    border: float = BORDER,
) -> PartPenetration:
    """Vertices of one part inside another part.

    A part is the faces whose three corners belong to it. It is cut out and every hole, where it was joined to
    the rest or the mesh is open, is closed by a fan; a vertex of another part is inside where the winding
    number of that closed surface is above one half and that of the whole mesh is above one: a vertex on
    the skin has less than one from what it lies on, and one more from what it has passed into. The second
    condition drops what lies in a fan's bulge alone: without it the shipped hand's thumb, opposed, was 8 mm
    inside a palm that it does not touch. The fan never gives the depth. What happens within
    one part is not seen, and neither is an overlap that no vertex of either part reaches into: the depth is
    a lower bound, short of the truth by less than an edge.

    Args:
        vertices: (V, 3) metres.
        faces: (F, 3) counter-clockwise from outside; may be open, as a hand is at the wrist.
        part_of_vertex: (V,) label of each vertex's part; a negative label stands for no part.
        border: a vertex closer than this to the other part, along the edges of the mesh, is left out, since
            there the skin of joined parts folds; in the unit of the vertices.

    Raises:
        ValueError: a boundary does not close, because faces at it are wound against one another.
    """
    return PartSurfaces(vertices, faces, part_of_vertex, border).penetration(vertices)


@dataclass(frozen=True, eq=False)
class _Part:
    """What depends on the topology alone: a part's faces, its closed surface, and who may pass into it."""

    label: int
    own_faces: Int[np.ndarray, " f"]
    own_vertices: Int[np.ndarray, " v"]
    local_faces: Int[np.ndarray, "f 3"]
    at_cut: Bool[np.ndarray, "f 3"]
    closed: _Closed
    tree: SurfaceTree
    candidates: Int[np.ndarray, " c"]


class _Closed:
    """A surface closed by fans: its loops are walked once, their middles follow the vertices."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        self._loops = boundary_loops(faces)
        self._faces = np.ascontiguousarray(capped_by_fans(vertices, faces)[1], dtype=np.int64)

    def winding_numbers(self, points: np.ndarray, vertices: np.ndarray) -> np.ndarray:
        middles = [vertices[loop].mean(axis=0, keepdims=True) for loop in self._loops]
        return winding_numbers(points, np.concatenate([vertices, *middles]), self._faces)


class PartSurfaces:
    """The parts of one topology, for surfaces that move: distances along the mesh are measured once."""

    def __init__(
        self,
        vertices: Float[np.ndarray, "V 3"],
        faces: Int[np.ndarray, "F 3"],
        part_of_vertex: Int[np.ndarray, " V"],
        border: float = BORDER,
    ) -> None:
        """Take apart a surface; arguments and errors as of ``part_penetration``."""
        edges = unique_edges(faces)
        lengths = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
        graph = sp.csr_matrix((lengths, edges.T), shape=(len(vertices), len(vertices)))
        self._part_of_vertex = part_of_vertex
        self._whole = _Closed(vertices, faces)
        self._parts: list[_Part] = []
        for label in np.unique(part_of_vertex[part_of_vertex >= 0]).tolist():
            own_faces = np.flatnonzero((part_of_vertex[faces] == label).all(axis=1))
            if not len(own_faces):
                continue
            own, local_faces, own_vertices = remove_unreferenced(vertices, faces[own_faces])
            members = np.flatnonzero(part_of_vertex == label)
            away = csgraph.dijkstra(graph, directed=False, indices=members, min_only=True, limit=border)
            candidates = np.flatnonzero((part_of_vertex >= 0) & (part_of_vertex != label) & (away > border))
            self._parts.append(
                _Part(
                    label,
                    own_faces,
                    own_vertices,
                    local_faces,
                    open_sides(local_faces),
                    _Closed(own, local_faces),
                    SurfaceTree(own, local_faces),
                    candidates,
                )
            )

    def penetration(self, vertices: Float[np.ndarray, "V 3"]) -> PartPenetration:
        """Vertices inside another part, with the surface moved to ``vertices`` (V, 3), metres."""
        found = [inside for part in self._parts if (inside := self._inside(part, vertices)) is not None]
        if not found:
            none = np.zeros(0, dtype=np.int64)
            return PartPenetration(none, none, none, np.zeros(0), none, np.zeros((0, 3)))
        names = ("vertices", "own_parts", "other_parts", "depths", "faces", "barycentric")
        return PartPenetration(*(np.concatenate([getattr(part, name) for part in found]) for name in names))

    def _inside(self, part: _Part, vertices: np.ndarray) -> PartPenetration | None:
        own = vertices[part.own_vertices]
        candidates = part.candidates[_in_oriented_box(vertices[part.candidates], own)]
        if not len(candidates):
            return None
        part.tree.refit(own)
        # Winding numbers were the largest part of a registration; most of the box is plainly outside.
        candidates = candidates[_not_outside(part, own, vertices[candidates])]
        for closed, surface, least in ((part.closed, own, 0.5), (self._whole, vertices, 1.0)):
            if not len(candidates):
                return None
            candidates = candidates[closed.winding_numbers(vertices[candidates], surface) > least]
        if not len(candidates):
            return None
        closest = part.tree.closest(vertices[candidates])
        return PartPenetration(
            candidates,
            self._part_of_vertex[candidates],
            np.full(len(candidates), part.label),
            closest.distances,
            part.own_faces[closest.faces],
            closest.barycentric,
        )


def _not_outside(part: _Part, own: np.ndarray, points: np.ndarray) -> Bool[np.ndarray, " _"]:
    """Points behind the closest face, or closest to where the part was cut out: they may be inside."""
    closest = part.tree.closest(points)
    normals = face_normals(own, part.local_faces)[closest.faces]
    behind = np.einsum("na,na->n", points - closest.points, normals) < 0
    return behind | (part.at_cut[closest.faces] & (closest.barycentric < 1e-9)).any(axis=1)


def _in_oriented_box(points: np.ndarray, part_vertices: np.ndarray) -> Bool[np.ndarray, " _"]:
    """Whether a point is in the part's box along its principal axes: a finger's box holds little else."""
    centre = part_vertices.mean(axis=0)
    offsets = part_vertices - centre
    axes = np.linalg.eigh(offsets.T @ offsets)[1]
    inside, asked = offsets @ axes, (points - centre) @ axes
    return ((asked >= inside.min(axis=0)) & (asked <= inside.max(axis=0))).all(axis=1)
