"""Kernel of the winding number: how many times a closed surface goes round a point."""

import numpy as np
from numba import njit, prange

LANES = 8  # points side by side, in vector registers
GATHERED = 16  # small angles whose sum stays under 1.6
SMALL = 0.1
# Rows of ``work``, LANES numbers each.
X, Y, Z, VOLUME, BELOW, REAL, IMAGINARY, TOTAL = (LANES * row for row in range(8))


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def add_face(p, q, r, work):
    """One face's solid angle as seen from each point: volume over below is the tangent of its half."""
    px, py, pz = p[0], p[1], p[2]
    qx, qy, qz = q[0], q[1], q[2]
    rx, ry, rz = r[0], r[1], r[2]
    for s in range(LANES):
        x, y, z = work[X + s], work[Y + s], work[Z + s]
        ax, ay, az = px - x, py - y, pz - z
        bx, by, bz = qx - x, qy - y, qz - z
        cx, cy, cz = rx - x, ry - y, rz - z
        a = np.sqrt(ax * ax + ay * ay + az * az)
        b = np.sqrt(bx * bx + by * by + bz * bz)
        c = np.sqrt(cx * cx + cy * cy + cz * cz)
        volume = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
        ab = ax * bx + ay * by + az * bz
        bc = bx * cx + by * cy + bz * cz
        ca = cx * ax + cy * ay + cz * az
        work[VOLUME + s] = volume
        work[BELOW + s] = a * b * c + ab * c + bc * a + ca * b


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def gather(work):
    """Small angles into the product of complex numbers 1 + i tan; True where one was too large for that."""
    large = 0
    for s in range(LANES):
        volume, below = work[VOLUME + s], work[BELOW + s]
        tangent = volume / below
        small = abs(volume) < SMALL * below
        tangent = tangent if small else 0.0
        large += 0 if small else 1
        real, imaginary = work[REAL + s], work[IMAGINARY + s]
        work[REAL + s] = real - imaginary * tangent
        work[IMAGINARY + s] = imaginary + real * tangent
    return large > 0


@njit(cache=True, error_model="numpy")
def wind_lanes(vertices, faces, work):
    """The sums of all faces' half angles as seen from the points in ``work``, into its row TOTAL."""
    for s in range(LANES):
        work[REAL + s], work[IMAGINARY + s], work[TOTAL + s] = 1.0, 0.0, 0.0
    for f in range(len(faces)):
        add_face(vertices[faces[f, 0]], vertices[faces[f, 1]], vertices[faces[f, 2]], work)
        if gather(work):
            for s in range(LANES):
                if not abs(work[VOLUME + s]) < SMALL * work[BELOW + s]:
                    work[TOTAL + s] += np.arctan2(work[VOLUME + s], work[BELOW + s])
        if f % GATHERED == GATHERED - 1:
            for s in range(LANES):
                work[TOTAL + s] += np.arctan2(work[IMAGINARY + s], work[REAL + s])
                work[REAL + s], work[IMAGINARY + s] = 1.0, 0.0
    for s in range(LANES):
        work[TOTAL + s] += np.arctan2(work[IMAGINARY + s], work[REAL + s])


@njit(cache=True, parallel=True, error_model="numpy")
def winding_numbers(points, vertices, faces):
    """Signed solid angles of all faces over 4 pi (Van Oosterom and Strackee 1983); 1 inside, 0 outside.

    One arctangent does for sixteen small angles. A point's number does not depend on the points beside it.
    """
    count = len(points)
    result = np.empty(count)
    for block in prange((count + LANES - 1) // LANES):
        work = np.empty(8 * LANES)
        for s in range(LANES):
            i = min(LANES * block + s, count - 1)
            work[X + s], work[Y + s], work[Z + s] = points[i, 0], points[i, 1], points[i, 2]
        wind_lanes(vertices, faces, work)
        for s in range(min(LANES, count - LANES * block)):
            result[LANES * block + s] = work[TOTAL + s] / (2 * np.pi)
    return result
