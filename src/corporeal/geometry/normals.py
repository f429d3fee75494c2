"""Normals and areas of triangle meshes; faces are counter-clockwise seen from outside."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from corporeal.geometry import normals_kernels as kernels


def face_vectors(
    vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]
) -> Float[np.ndarray, "F 3"]:
    """Outward normals times twice the area of their faces, in the square of the vertices' unit."""
    vertices, faces = _checked(vertices, faces)
    vectors = np.empty((len(faces), 3), dtype=vertices.dtype)
    kernels.fill_face_vectors(vertices, faces, vectors)
    return vectors


def face_areas(vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]) -> Float[np.ndarray, " F"]:
    """Areas in the square of the vertices' unit."""
    return 0.5 * _length(face_vectors(vertices, faces))


def areas_around(
    vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]
) -> Float[np.ndarray, " V"]:
    """Of all faces at every vertex together, in the square of the vertices' unit: thrice its own share."""
    return np.bincount(faces.ravel(), np.repeat(face_areas(vertices, faces), 3), minlength=len(vertices))


def face_normals(
    vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]
) -> Float[np.ndarray, "F 3"]:
    """Outward unit normals; zero for a face without area."""
    return _unit(face_vectors(vertices, faces))


def vertex_normals(
    vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]
) -> Float[np.ndarray, "V 3"]:
    """Outward unit normals of vertices: the mean of the faces' normals, weighted by the angle at the vertex.

    Angles make the normal independent of how a flat region is triangulated, and give the sign of a distance
    (Baerentzen and Aanaes 2005, "Signed distance computation using the angle weighted pseudonormal").
    Zero for a vertex that no face with an area refers to.
    """
    vertices, faces = _checked(vertices, faces)
    total = np.zeros((3, len(vertices), 3), dtype=vertices.dtype)
    kernels.add_corner_normals(vertices, faces, face_vectors(vertices, faces), total)
    return _unit(total.sum(axis=0))


def _checked(
    vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]
) -> tuple[Float[np.ndarray, "V 3"], Int[np.ndarray, "F 3"]]:
    """Arrays as the kernels take them, which read memory at whatever index they are given."""
    faces = np.ascontiguousarray(faces, dtype=np.int64)
    if faces.size and (faces.min() < 0 or faces.max() >= len(vertices)):
        raise IndexError(f"faces: expected indices from 0 to {len(vertices) - 1}")
    return np.ascontiguousarray(vertices), faces


def _length(vectors: np.ndarray) -> np.ndarray:
    return np.sqrt(np.einsum("nc,nc->n", vectors, vectors))


def _unit(vectors: np.ndarray) -> np.ndarray:
    length = _length(vectors)
    return vectors / np.where(length > 0, length, 1)[:, None]
