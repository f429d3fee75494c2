"""Kernels of normals: fits ask for those of a moving surface at every evaluation.

Written out over whole arrays, which make ten of the surface's size on the way, they took five times as long.
"""

import numpy as np
from numba import njit


@njit(cache=True, error_model="numpy")
def fill_face_vectors(vertices, faces, vectors):
    """Cross products of the sides from the first corner, (F, 3)."""
    for f in range(len(faces)):
        j, k, m = faces[f, 0], faces[f, 1], faces[f, 2]
        x, y, z = vertices[j, 0], vertices[j, 1], vertices[j, 2]
        ax, ay, az = vertices[k, 0] - x, vertices[k, 1] - y, vertices[k, 2] - z
        bx, by, bz = vertices[m, 0] - x, vertices[m, 1] - y, vertices[m, 2] - z
        vectors[f, 0] = ay * bz - az * by
        vectors[f, 1] = az * bx - ax * bz
        vectors[f, 2] = ax * by - ay * bx


@njit(cache=True, error_model="numpy")
def add_corner_normals(vertices, faces, vectors, total):
    """Add every face's unit normal to its corners, times the angle there.

    ``total`` (3, V, 3) begins at zero: first corners, second corners and third corners add up apart.
    """
    for f in range(len(faces)):
        x, y, z = vectors[f, 0], vectors[f, 1], vectors[f, 2]
        length = np.sqrt(x * x + y * y + z * z)
        if not length > 0:
            continue
        x, y, z = x / length, y / length, z / length
        for corner in range(3):
            i, j, k = faces[f, corner], faces[f, (corner + 1) % 3], faces[f, (corner + 2) % 3]
            cosine = 0.0
            for axis in range(3):
                here = vertices[i, axis]
                cosine += (vertices[j, axis] - here) * (vertices[k, axis] - here)
            angle = np.arctan2(length, cosine)
            total[corner, i, 0] += angle * x
            total[corner, i, 1] += angle * y
            total[corner, i, 2] += angle * z
