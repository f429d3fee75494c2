"""A virtual hand-held scanner: cameras on an arc, own triangulation, noise, holes where no camera looks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
import trimesh
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.spatial import cKDTree

from corporeal.geometry.cameras import Pinhole
from corporeal.geometry.rasteriser import rasterise

_PIXELS = 900
_STEEPEST = np.deg2rad(72.0)  # a scanner gets no depth where it looks along the surface
_SHADOW = 1.0e-3  # metres behind the nearest surface at which a point counts as hidden


@dataclass(frozen=True, eq=False)
class Capture:
    """What the scanner saw: points (N, 3) with noise, faces (F, 3), the points without noise (N, 3)."""

    points: np.ndarray
    faces: np.ndarray
    clean: np.ndarray


def smooth_surface(vertices: np.ndarray, faces: np.ndarray, times: int) -> tuple[np.ndarray, np.ndarray]:
    """Loop subdivision: the limit surface of the coarse mesh, nearly."""
    fine, fine_faces = trimesh.remesh.subdivide_loop(vertices, faces, iterations=times)
    return np.asarray(fine), np.asarray(fine_faces)


def capture(
    vertices: np.ndarray, faces: np.ndarray, eyes: np.ndarray, count: int, noise: float,
    generator: np.random.Generator,
) -> Capture:  # fmt: skip
    """Scan a fine surface from eyes (C, 3) with about ``count`` points and ``noise``, all in metres."""
    points, normals, own_faces = _retriangulated(vertices, faces, count, generator)
    direction = np.zeros_like(points)
    best = np.full(len(points), np.cos(_STEEPEST))
    for eye in eyes:
        cosine = _visible_cosine(points, normals, vertices, faces, eye)
        better = cosine > best
        to_eye = eye - points[better]
        direction[better] = to_eye / np.linalg.norm(to_eye, axis=1, keepdims=True)
        best[better] = cosine[better]
    seen = np.linalg.norm(direction, axis=1) > 0
    # Depth noise grows where the surface is seen obliquely.
    sigma = noise / np.sqrt(np.maximum(best, 0.2))
    noisy = points + direction * (sigma * generator.normal(size=len(points)))[:, None]
    faces_seen = own_faces[seen[own_faces].all(axis=1)]
    used, faces_seen = _largest_piece(faces_seen, len(points))
    return Capture(noisy[used], faces_seen, points[used])


def _visible_cosine(
    points: np.ndarray, normals: np.ndarray, vertices: np.ndarray, faces: np.ndarray, eye: np.ndarray
) -> np.ndarray:
    """Cosine between normal and line of sight per point; -1 where the point is hidden."""
    camera = Pinhole.look_at(
        eye, vertices.mean(0), np.array([0.3, 0.2, 1.0]), np.deg2rad(38.0), (_PIXELS, _PIXELS)
    )
    depth = rasterise(vertices, faces, camera).depth
    pixels, own_depth = camera.project(points)
    column, row = np.clip(np.floor(pixels).astype(int), 0, _PIXELS - 1).T
    visible = own_depth < depth[row, column] + _SHADOW
    to_eye = eye - points
    cosine = (normals * to_eye).sum(1) / np.linalg.norm(to_eye, axis=1)
    return np.where(visible, cosine, -1.0)


def _retriangulated(
    vertices: np.ndarray, faces: np.ndarray, count: int, generator: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Evenly spread points on the surface with normals, joined where their cells meet (a Voronoi dual)."""
    seeds = _blue_noise(vertices, faces, count, generator)
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    lengths = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
    graph = sp.coo_matrix((lengths, (edges[:, 0], edges[:, 1])), shape=(len(vertices),) * 2).tocsr()
    graph = graph.maximum(graph.T)
    _, _, nearest = dijkstra(graph, directed=False, indices=seeds, min_only=True, return_predecessors=True)
    cell = np.searchsorted(seeds, nearest)
    corners = cell[faces]
    a, b, c = corners.T
    dual = corners[(a != b) & (b != c) & (c != a)]
    first = dual.argmin(axis=1)[:, None]
    dual = np.take_along_axis(dual, (first + np.arange(3)) % 3, axis=1)
    dual = np.unique(dual, axis=0)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    return vertices[seeds], np.asarray(mesh.vertex_normals)[seeds], dual


def _blue_noise(
    vertices: np.ndarray, faces: np.ndarray, count: int, generator: np.random.Generator
) -> np.ndarray:
    """Sorted indices of vertices that keep a distance from one another, drawn in random order."""
    area = trimesh.Trimesh(vertices, faces, process=False).area
    radius = 0.72 * np.sqrt(area / count)
    neighbours = cKDTree(vertices)
    alive = np.ones(len(vertices), dtype=bool)
    chosen = []
    for vertex in generator.permutation(len(vertices)):
        if alive[vertex]:
            chosen.append(vertex)
            alive[neighbours.query_ball_point(vertices[vertex], radius)] = False
    return np.sort(chosen)


def _largest_piece(faces: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]]])
    graph = sp.coo_matrix((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(count, count))
    _, piece = connected_components(graph, directed=False)
    kept = faces[piece[faces[:, 0]] == np.bincount(piece[faces[:, 0]]).argmax()]
    used, renumbered = np.unique(kept, return_inverse=True)
    return used, renumbered.reshape(-1, 3)
