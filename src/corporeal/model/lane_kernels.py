"""Kernels that pose LANES surfaces side by side: every operation works on all of them in vector registers.

``model`` is a ``CpuArrays``; a motion is 3 x 4, rotation row-major in 0..8, offset in 9..11.
``rest`` is (3 V, B) with B a multiple of LANES, ``motion`` (B / LANES, K, 12 * LANES). Vertices go through a
tile, because callers want them by surface: writing three numbers at a time into 8 surfaces misses the cache.
"""

import numpy as np
from numba import njit, prange

# The motions of 55 joints and their gradients are 21 kB each in float32 and share the first-level cache. With
# 16 lanes they did not: the way back took 1.6 times as long for 55 joints, the way there 0.9 times.
LANES = 8
TILE = 32  # vertices; a tile of 8 surfaces in float32 is 3 kB


@njit(cache=True, fastmath=True)
def blend_lanes(i, count, model, motion, blended):
    """Weighted sum of the first ``count`` numbers of the motions that move one vertex."""
    first, last = model.weight_starts[i], model.weight_starts[i + 1]
    k, weight = model.weight_joints[first], model.weight_values[first]
    for e in range(count):
        blended[e] = weight * motion[k, e]
    n = first + 1
    while n + 1 < last:  # in pairs: half the passes over ``blended``
        k, weight = model.weight_joints[n], model.weight_values[n]
        j, other = model.weight_joints[n + 1], model.weight_values[n + 1]
        for e in range(count):
            blended[e] += weight * motion[k, e] + other * motion[j, e]
        n += 2
    if n < last:
        k, weight = model.weight_joints[n], model.weight_values[n]
        for e in range(count):
            blended[e] += weight * motion[k, e]


@njit(cache=True, fastmath=True)
def pose_tile(first, last, lane, model, motion, rest, translation, vertices):
    """Skin the vertices ``first`` to ``last`` of the surfaces ``lane`` to ``lane + LANES``."""
    tile = np.empty((3 * TILE, LANES), rest.dtype)
    blended = np.empty(12 * LANES, rest.dtype)
    points = np.empty((3, LANES), rest.dtype)
    for i in range(first, last):
        blend_lanes(i, 12 * LANES, model, motion, blended)
        for a in range(3):
            for s in range(LANES):
                points[a, s] = rest[3 * i + a, lane + s]
        for a in range(3):
            row = 3 * (i - first) + a
            for s in range(LANES):
                tile[row, s] = (
                    blended[(3 * a) * LANES + s] * points[0, s]
                    + blended[(3 * a + 1) * LANES + s] * points[1, s]
                    + blended[(3 * a + 2) * LANES + s] * points[2, s]
                    + blended[(9 + a) * LANES + s]
                )
    for s in range(min(LANES, len(vertices) - lane)):
        for i in range(last - first):
            for a in range(3):
                vertices[lane + s, first + i, a] = tile[3 * i + a, s] + translation[lane + s, a]


@njit(cache=True, parallel=True)
def pose_many(model, motion, rest, translation, vertices):
    """``pose_tile`` over all tiles of all surfaces."""
    V = vertices.shape[1]
    tiles = (V + TILE - 1) // TILE
    for t in prange(tiles):
        for block in range(len(motion)):
            last = min(V, (t + 1) * TILE)
            pose_tile(t * TILE, last, block * LANES, model, motion[block], rest, translation, vertices)


@njit(cache=True, fastmath=True)
def unpose_vertex(i, lane, model, motion, rest, work, by_motion, by_rest):
    """Gradients by rest position and motions of one vertex.

    ``work[1, 9 * LANES :]`` holds the gradient by the vertex; it is also that by the motion's offset.
    """
    blended, outer = work[0], work[1]
    blend_lanes(i, 9 * LANES, model, motion, blended)
    for c in range(3):
        for s in range(LANES):
            x, y, z = outer[9 * LANES + s], outer[10 * LANES + s], outer[11 * LANES + s]
            place = rest[3 * i + c, lane + s]
            by_rest[3 * i + c, lane + s] = (
                blended[c * LANES + s] * x
                + blended[(3 + c) * LANES + s] * y
                + blended[(6 + c) * LANES + s] * z
            )
            outer[c * LANES + s] = x * place
            outer[(3 + c) * LANES + s] = y * place
            outer[(6 + c) * LANES + s] = z * place
    for n in range(model.weight_starts[i], model.weight_starts[i + 1]):
        k, weight = model.weight_joints[n], model.weight_values[n]
        for e in range(12 * LANES):
            by_motion[k, e] += weight * outer[e]


@njit(cache=True, fastmath=True)
def unpose_tile(tile, lane, model, motion, rest, by_vertices, by_motion, by_rest):
    """``unpose_vertex`` for the vertices of ``tile`` (first, last) of LANES surfaces, read one by one."""
    first, last = tile
    pull = np.zeros((TILE, 3 * LANES), rest.dtype)
    work = np.empty((2, 12 * LANES), rest.dtype)
    for s in range(min(LANES, len(by_vertices) - lane)):
        for i in range(last - first):
            for a in range(3):
                pull[i, a * LANES + s] = by_vertices[lane + s, first + i, a]
    for i in range(first, last):
        for e in range(3 * LANES):
            work[1, 9 * LANES + e] = pull[i - first, e]
        unpose_vertex(i, lane, model, motion, rest, work, by_motion, by_rest)


@njit(cache=True, parallel=True)
def unpose_many(model, motion, rest, by_vertices, by_motion, by_rest):
    """Gradients by motions and rest surface.

    ``by_motion`` (splits, blocks, K, 12 * LANES) is to be summed over the splits of the vertices, which give
    every thread its own. Blocks run inside the tiles, so that ``rest`` and ``by_rest`` are walked once.
    """
    V = by_vertices.shape[1]
    splits, blocks = by_motion.shape[:2]
    for split in prange(splits):
        end = (split + 1) * V // splits
        for first in range(split * V // splits, end, TILE):
            last = min(first + TILE, end)
            for block in range(blocks):
                unpose_tile(
                    (first, last), block * LANES, model, motion[block], rest, by_vertices,
                    by_motion[split, block], by_rest,
                )  # fmt: skip
