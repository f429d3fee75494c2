"""Closed surfaces in tetrahedra, by fTetWild (the wheel wildmeshing); the capped hand."""

from __future__ import annotations

import contextlib
import tempfile

import numpy as np
import trimesh
from scipy.spatial import Delaunay

# Lengths of edges wanted where x lies at these places, metres: finer in the fingers, coarse in the forearm.
# An even 3.6 mm made 88,000 tetrahedra and 1-3 s a pose for no visible gain.
_AT = (-0.3, -0.11, -0.07, -0.03, 0.0, 0.2)
_EDGES = (5.0e-3, 5.0e-3, 7.0e-3, 7.0e-3, 10e-3, 10e-3)
# How far the surface may move, metres. The mesh before its subdivision as input would do with half the
# elements on the surface, and leaves 1 mm of skin outside in the webs.
_ENVELOPE = 0.28e-3


def tetrahedralised(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The hand: vertices (T, 3) in metres and tetrahedra (M, 4) of positive volume."""
    vertices, faces = np.asarray(vertices, dtype=np.float64), np.asarray(faces, dtype=np.int64)
    corners = np.array([[x, y, z] for x in _AT for y in (-0.2, 0.2) for z in (-0.2, 0.2)])
    return meshed(vertices, _capped(vertices, faces), corners, np.repeat(_EDGES, 4), _ENVELOPE)


def meshed(
    vertices: np.ndarray, faces: np.ndarray, corners: np.ndarray, edges: np.ndarray, envelope: float
) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (T, 3) in metres and tetrahedra (M, 4) of positive volume inside a closed surface.

    Args:
        vertices: metres.
        faces: closed; triangles may meet or overlap.
        corners: (n, 3) places round the surface, metres, among which the length of edges is interpolated.
        edges: (n,) lengths wanted there, metres.
        envelope: how far the surface may move, metres.
    """
    import wildmeshing

    diagonal = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    meshing = wildmeshing.Tetrahedralizer(
        stop_quality=8, edge_length_r=float(edges.max()) / diagonal, epsilon=envelope / diagonal
    )
    # fTetWild leaves a file of its own in the working folder.
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        trimesh.Trimesh(vertices, faces, process=False).export("surface.off")
        meshing.load_mesh("surface.off")
        meshing.set_sizing_field(corners, _filled(corners), edges[:, None])
        meshing.tetrahedralize()
        points, tets, *_ = meshing.get_tet_mesh()
    return _oriented(points, tets)


def _filled(corners: np.ndarray) -> np.ndarray:
    """Tetrahedra (m, 4) of positive volume between the corners."""
    # Delaunay needs corners that do not lie on a common sphere.
    shaken = corners + 1e-6 * np.random.default_rng(0).normal(size=corners.shape)
    tets = Delaunay(shaken).simplices
    volumes = _volumes(corners, tets)
    tets, volumes = tets[np.abs(volumes) > 1e-12], volumes[np.abs(volumes) > 1e-12]
    return np.where((volumes < 0)[:, None], tets[:, [1, 0, 2, 3]], tets).astype(np.int32)


def _oriented(points: np.ndarray, tets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positive volumes, vertices in use only, float32 and uint16."""
    tets = np.where((_volumes(points, tets) < 0)[:, None], tets[:, [1, 0, 2, 3]], tets)
    used, tets = np.unique(tets, return_inverse=True)
    points, tets = points[used].astype(np.float32), tets.reshape(-1, 4)
    if len(points) > np.iinfo(np.uint16).max:
        raise SystemExit(f"{len(points)} vertices: more than uint16 counts; ask for longer edges")
    smallest = _volumes(points.astype(np.float64), tets).min()
    print(f"{len(points)} vertices, {len(tets)} tetrahedra, smallest {smallest * 1e9:.3f} mm^3")
    if not smallest > 0:
        raise SystemExit("an element is flat")
    return points, tets.astype(np.uint16)


def _volumes(points: np.ndarray, tets: np.ndarray) -> np.ndarray:
    corners = points[tets]
    return np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6


def _capped(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Faces with the open end of the forearm closed by a fan from its first vertex."""
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    loops = mesh.outline().entities
    if len(loops) != 1:
        raise SystemExit(f"one open end was expected, {len(loops)} were found")
    loop = loops[0].points[:-1]
    sides = {tuple(side) for side in faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2).tolist()}
    if (loop[0], loop[1]) in sides:
        loop = loop[::-1]
    fan = [[loop[0], loop[k], loop[k + 1]] for k in range(1, len(loop) - 1)]
    return np.vstack([faces, fan])
