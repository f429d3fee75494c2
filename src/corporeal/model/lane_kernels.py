"""Kernels that pose LANES surfaces side by side: every operation works on all of them in vector registers.

``rest`` is (3 V, B) with B a multiple of LANES, ``motion`` (B / LANES, K, 12 * LANES). Vertices go through a
tile, because callers want them by surface: writing three numbers at a time into 16 surfaces misses the cache.
"""

import numpy as np
from numba import njit, prange

LANES = 16
TILE = 32  # vertices; a tile of 16 surfaces in float32 is 6 kB


@njit(cache=True, fastmath=True)
def blend_lanes(i, count, weights, motion, blended):
    """Weighted sum of the first ``count`` numbers of the motions that move one vertex."""
    first = weights.starts[i]
    k, weight = weights.joints[first], weights.values[first]
    for e in range(count):
        blended[e] = weight * motion[k, e]
    for n in range(first + 1, weights.starts[i + 1]):
        k, weight = weights.joints[n], weights.values[n]
        for e in range(count):
            blended[e] += weight * motion[k, e]


@njit(cache=True, fastmath=True)
def pose_tile(first, last, lane, weights, motion, rest, translation, vertices):
    """Skin the vertices ``first`` to ``last`` of the surfaces ``lane`` to ``lane + LANES``."""
    tile = np.empty((3 * TILE, LANES), rest.dtype)
    blended = np.empty(12 * LANES, rest.dtype)
    points = np.empty((3, LANES), rest.dtype)
    for i in range(first, last):
        blend_lanes(i, 12 * LANES, weights, motion, blended)
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
def pose_many(weights, motion, rest, translation, vertices):
    """``pose_tile`` over all tiles of all surfaces."""
    V = vertices.shape[1]
    tiles = (V + TILE - 1) // TILE
    for t in prange(tiles):
        for block in range(len(motion)):
            last = min(V, (t + 1) * TILE)
            pose_tile(t * TILE, last, block * LANES, weights, motion[block], rest, translation, vertices)


@njit(cache=True, fastmath=True)
def unpose_vertex(i, lane, weights, motion, rest, pull, blended, outer, by_motion, by_rest):
    """Gradients by rest position and motions of one vertex; ``pull`` (3, LANES) is that by the vertex."""
    blend_lanes(i, 9 * LANES, weights, motion, blended)
    for c in range(3):
        for s in range(LANES):
            place = rest[3 * i + c, lane + s]
            by_rest[3 * i + c, lane + s] = (
                blended[c * LANES + s] * pull[0, s]
                + blended[(3 + c) * LANES + s] * pull[1, s]
                + blended[(6 + c) * LANES + s] * pull[2, s]
            )
            outer[c * LANES + s] = pull[0, s] * place
            outer[(3 + c) * LANES + s] = pull[1, s] * place
            outer[(6 + c) * LANES + s] = pull[2, s] * place
            outer[(9 + c) * LANES + s] = pull[c, s]
    for n in range(weights.starts[i], weights.starts[i + 1]):
        k, weight = weights.joints[n], weights.values[n]
        for e in range(12 * LANES):
            by_motion[k, e] += weight * outer[e]


@njit(cache=True, parallel=True)
def unpose_many(splits, weights, motion, rest, by_vertices, by_motion, by_rest):
    """Gradients by motions and rest surface; ``by_motion`` (splits, blocks, K, 12 * LANES) is to be summed."""
    B, V = by_vertices.shape[:2]
    blocks = len(motion)
    for task in prange(splits * blocks):
        split, block = task // blocks, task % blocks
        lane = block * LANES
        pull = np.zeros((3, LANES), rest.dtype)
        blended, outer = np.empty(12 * LANES, rest.dtype), np.empty(12 * LANES, rest.dtype)
        for i in range(split * V // splits, (split + 1) * V // splits):
            for s in range(min(LANES, B - lane)):
                for a in range(3):
                    pull[a, s] = by_vertices[lane + s, i, a]
            unpose_vertex(
                i, lane, weights, motion[block], rest, pull, blended, outer, by_motion[split, block], by_rest
            )
