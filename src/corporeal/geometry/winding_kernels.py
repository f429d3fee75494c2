"""Kernel of the winding number: how many times a closed surface goes round a point."""

import numpy as np
from numba import njit, prange


@njit(cache=True, parallel=True, error_model="numpy")
def winding_numbers(points, vertices, faces):
    """Signed solid angles of all faces over 4 pi (Van Oosterom and Strackee 1983); 1 inside, 0 outside.

    Small angles are added by multiplying complex numbers 1 + i tan, up to a sum of 1.6: one arctangent does
    for sixteen faces, which takes a third of the time.
    """
    result = np.empty(len(points))
    for i in prange(len(points)):
        total = 0.0
        real, imaginary, gathered = 1.0, 0.0, 0
        for f in range(len(faces)):
            j, k, m = faces[f, 0], faces[f, 1], faces[f, 2]
            ax, ay, az = (
                vertices[j, 0] - points[i, 0],
                vertices[j, 1] - points[i, 1],
                vertices[j, 2] - points[i, 2],
            )
            bx, by, bz = (
                vertices[k, 0] - points[i, 0],
                vertices[k, 1] - points[i, 1],
                vertices[k, 2] - points[i, 2],
            )
            cx, cy, cz = (
                vertices[m, 0] - points[i, 0],
                vertices[m, 1] - points[i, 1],
                vertices[m, 2] - points[i, 2],
            )
            a = np.sqrt(ax * ax + ay * ay + az * az)
            b = np.sqrt(bx * bx + by * by + bz * bz)
            c = np.sqrt(cx * cx + cy * cy + cz * cz)
            volume = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
            ab = ax * bx + ay * by + az * bz
            bc = bx * cx + by * cy + bz * cz
            ca = cx * ax + cy * ay + cz * az
            below = a * b * c + ab * c + bc * a + ca * b
            if not abs(volume) < 0.1 * below:
                total += np.arctan2(volume, below)
                continue
            tangent = volume / below
            real, imaginary = real - imaginary * tangent, imaginary + real * tangent
            gathered += 1
            if gathered == 16:
                total += np.arctan2(imaginary, real)
                real, imaginary, gathered = 1.0, 0.0, 0
        result[i] = (total + np.arctan2(imaginary, real)) / (2 * np.pi)
    return result
