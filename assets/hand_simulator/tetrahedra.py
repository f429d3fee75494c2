"""The capped hand in tetrahedra, by fTetWild (the wheel wildmeshing)."""

from __future__ import annotations

import contextlib
import tempfile
from pathlib import Path

import numpy as np
import trimesh

# Metres, target length of an edge: 3.6 mm gave 88,000 tetrahedra and 1-3 s a pose for no visible gain.
_EDGE = 4.6e-3
_ENVELOPE = 0.35e-3  # metres the surface may move


def tetrahedralised(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (T, 3) in metres and tetrahedra (M, 4) of positive volume."""
    import wildmeshing

    vertices, faces = np.asarray(vertices, dtype=np.float64), np.asarray(faces, dtype=np.int64)
    closed = _capped(vertices, faces)
    diagonal = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    # fTetWild leaves files where it runs.
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        path = Path(folder) / "hand.off"
        trimesh.Trimesh(vertices, closed, process=False).export(path)
        meshing = wildmeshing.Tetrahedralizer(
            stop_quality=8, edge_length_r=_EDGE / diagonal, epsilon=_ENVELOPE / diagonal
        )
        meshing.load_mesh(str(path))
        meshing.tetrahedralize()
        points, tets, *_ = meshing.get_tet_mesh()
    corners = points[tets]
    volume = np.linalg.det(corners[:, 1:] - corners[:, :1])
    tets = np.where((volume < 0)[:, None], tets[:, [1, 0, 2, 3]], tets)
    used, tets = np.unique(tets, return_inverse=True)
    points, tets = points[used].astype(np.float32), tets.reshape(-1, 4)
    corners = points.astype(np.float64)[tets]
    volume = np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6
    print(f"{len(points)} vertices, {len(tets)} tetrahedra, smallest {volume.min() * 1e9:.3f} mm^3")
    if not volume.min() > 0:
        raise SystemExit("an element is flat")
    return points, tets.astype(np.uint16)


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
