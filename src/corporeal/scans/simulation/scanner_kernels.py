"""Spreading points evenly, and what a camera sees of them; one thread: sessions run a process per core."""

import numpy as np
from numba import njit


@njit(cache=True)
def spread(points, order, radius, low, shape):
    """Indices of points, taken in order, that keep a distance from those taken before."""
    head = np.full(shape[0] * shape[1] * shape[2], -1)
    following = np.full(len(points), -1)
    chosen = np.empty(len(points), np.int64)
    count = 0
    square = radius * radius
    for index in order:
        x, y, z = points[index]
        i, j, k = int((x - low[0]) / radius), int((y - low[1]) / radius), int((z - low[2]) / radius)
        free = True
        for ci in range(max(i - 1, 0), min(i + 2, shape[0])):
            for cj in range(max(j - 1, 0), min(j + 2, shape[1])):
                for ck in range(max(k - 1, 0), min(k + 2, shape[2])):
                    other = head[(ci * shape[1] + cj) * shape[2] + ck]
                    while other >= 0 and free:
                        gap = (
                            (points[other, 0] - x) ** 2
                            + (points[other, 1] - y) ** 2
                            + (points[other, 2] - z) ** 2
                        )
                        if gap < square:
                            free = False
                        other = following[other]
        if free:
            cell = (i * shape[1] + j) * shape[2] + k
            following[index] = head[cell]
            head[cell] = index
            chosen[count] = index
            count += 1
    return chosen[:count]


@njit(cache=True)
def seen_cosines(points, normals, R, t, lens, eye, depth, bias):
    """Cosine between normal and line of sight where a camera sees a point, -1 where it does not.

    ``bias`` is the depth in metres at which a surface hides what lies behind it; the slope of the surface
    within a pixel is added to it.
    """
    height, width = depth.shape
    cosines = np.full(len(points), -1.0)
    for p in range(len(points)):
        x = R[0, 0] * points[p, 0] + R[0, 1] * points[p, 1] + R[0, 2] * points[p, 2] + t[0]
        y = R[1, 0] * points[p, 0] + R[1, 1] * points[p, 1] + R[1, 2] * points[p, 2] + t[1]
        z = R[2, 0] * points[p, 0] + R[2, 1] * points[p, 1] + R[2, 2] * points[p, 2] + t[2]
        if z <= 0:
            continue
        column, row = int(lens[0] * x / z + lens[2]), int(lens[1] * y / z + lens[3])
        if column < 0 or row < 0 or column >= width or row >= height:
            continue
        away = eye - points[p]
        cosine = (normals[p] @ away) / np.sqrt(away @ away)
        if cosine <= 0.05:
            continue
        slope = z / lens[0] * np.sqrt(1.0 - min(cosine * cosine, 1.0)) / cosine
        if z < depth[row, column] + bias + 1.5 * slope:
            cosines[p] = cosine
    return cosines
