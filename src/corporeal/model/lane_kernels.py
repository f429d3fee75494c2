"""Kernels that pose LANES surfaces side by side: every operation works on all of them in vector registers.

``model`` is a ``CpuArrays``; a motion is 3 x 4, rotation row-major in 0..8, offset in 9..11; ``motion`` is
(B / LANES, K, 12 * LANES), B a multiple of LANES. A call does one ``Band`` of vertices. They go through a
tile, because callers want them by surface: three numbers at a time, written into LANES surfaces, miss the
cache.

``work`` is one array for all that a vertex needs, because loops over one array have no checks for overlap,
which cost more than 16 lanes of work.
"""

import numpy as np
from numba import njit, prange

# One cache line of float32. Of 8 lanes the compiler made scalar code on some processors, three times as slow.
LANES = 16
TILE = 32  # vertices; a tile of 16 surfaces in float32 is 6 kB
SPLITS = 8  # of a band, for the threads; on the way back each has its own sums


@njit(cache=True, fastmath=True)
def blend_lanes(i, model, motion, work):
    """Weighted sum of the motions that move one vertex, into ``work[: 12 * LANES]``."""
    first, last = model.weight_starts[i], model.weight_starts[i + 1]
    joints, weights = model.weight_joints, model.weight_values
    if last - first == 4:  # as most have: one pass over ``work``
        j, k, m, n = joints[first], joints[first + 1], joints[first + 2], joints[first + 3]
        p, q, r, s = weights[first], weights[first + 1], weights[first + 2], weights[first + 3]
        for e in range(12 * LANES):
            work[e] = p * motion[j, e] + q * motion[k, e] + r * motion[m, e] + s * motion[n, e]
        return
    for e in range(12 * LANES):
        work[e] = weights[first] * motion[joints[first], e]
    for n in range(first + 1, last):
        for e in range(12 * LANES):
            work[e] += weights[n] * motion[joints[n], e]


@njit(cache=True, fastmath=True)
def load_rest(i, lane, band, work, place):
    """The rest position of one vertex into three lanes of ``work``."""
    row = 3 * (i - band.first)
    for s in range(LANES):
        work[place * LANES + s] = band.rest[row, lane + s]
        work[(place + 1) * LANES + s] = band.rest[row + 1, lane + s]
        work[(place + 2) * LANES + s] = band.rest[row + 2, lane + s]


@njit(cache=True, fastmath=True)
def move_lanes(work):
    """Motion 0..11 of ``work`` applied to the position 12..14, into 15..17."""
    for s in range(LANES):
        x, y, z = work[12 * LANES + s], work[13 * LANES + s], work[14 * LANES + s]
        a, b, c = work[s], work[LANES + s], work[2 * LANES + s]
        work[15 * LANES + s] = a * x + b * y + c * z + work[9 * LANES + s]
        a, b, c = work[3 * LANES + s], work[4 * LANES + s], work[5 * LANES + s]
        work[16 * LANES + s] = a * x + b * y + c * z + work[10 * LANES + s]
        a, b, c = work[6 * LANES + s], work[7 * LANES + s], work[8 * LANES + s]
        work[17 * LANES + s] = a * x + b * y + c * z + work[11 * LANES + s]


@njit(cache=True, fastmath=True)
def pose_tile(tile, lane, model, motion, band, translation, vertices):
    """Skin the vertices ``tile`` (first, last) of the surfaces ``lane`` to ``lane + LANES``."""
    first, last = tile
    posed = np.empty((TILE, 3 * LANES), band.rest.dtype)
    work = np.empty(18 * LANES, band.rest.dtype)
    for i in range(first, last):
        blend_lanes(i, model, motion, work)
        load_rest(i, lane, band, work, 12)
        move_lanes(work)
        for e in range(3 * LANES):
            posed[i - first, e] = work[15 * LANES + e]
    for s in range(min(LANES, len(vertices) - lane)):
        for i in range(last - first):
            for a in range(3):
                vertices[lane + s, first + i, a] = posed[i, a * LANES + s] + translation[lane + s, a]


@njit(cache=True, parallel=True)
def pose_many(model, motion, band, translation, vertices):
    """``pose_tile`` over all tiles of a band, of all surfaces."""
    count = band.last - band.first
    for split in prange(SPLITS):
        end = band.first + (split + 1) * count // SPLITS
        for block in range(len(motion)):
            for first in range(band.first + split * count // SPLITS, end, TILE):
                tile = (first, min(first + TILE, end))
                pose_tile(tile, block * LANES, model, motion[block], band, translation, vertices)


@njit(cache=True, fastmath=True)
def turn_back_lanes(work):
    """From motion 0..8, rest position 9..11 and gradient 21..23 of ``work``.

    The gradient by the rest position goes to 9..11, that by the motion to 12..20; that by its offset is
    already in 21..23.
    """
    for s in range(LANES):
        x, y, z = work[21 * LANES + s], work[22 * LANES + s], work[23 * LANES + s]
        u, v, w = work[9 * LANES + s], work[10 * LANES + s], work[11 * LANES + s]
        work[9 * LANES + s] = work[s] * x + work[3 * LANES + s] * y + work[6 * LANES + s] * z
        work[10 * LANES + s] = work[LANES + s] * x + work[4 * LANES + s] * y + work[7 * LANES + s] * z
        work[11 * LANES + s] = work[2 * LANES + s] * x + work[5 * LANES + s] * y + work[8 * LANES + s] * z
        work[12 * LANES + s], work[13 * LANES + s], work[14 * LANES + s] = x * u, x * v, x * w
        work[15 * LANES + s], work[16 * LANES + s], work[17 * LANES + s] = y * u, y * v, y * w
        work[18 * LANES + s], work[19 * LANES + s], work[20 * LANES + s] = z * u, z * v, z * w


@njit(cache=True, fastmath=True)
def unpose_vertex(i, lane, model, motion, band, work, by_motion, by_rest):
    """Gradients by rest position and motions of vertex ``i``; ``work`` holds that by its place, see above."""
    blend_lanes(i, model, motion, work)
    load_rest(i, lane, band, work, 9)
    turn_back_lanes(work)
    row = 3 * (i - band.first)
    for s in range(LANES):
        by_rest[row, lane + s] = work[9 * LANES + s]
        by_rest[row + 1, lane + s] = work[10 * LANES + s]
        by_rest[row + 2, lane + s] = work[11 * LANES + s]
    for n in range(model.weight_starts[i], model.weight_starts[i + 1]):
        k, weight = model.weight_joints[n], model.weight_values[n]
        for e in range(12 * LANES):
            by_motion[k, e] += weight * work[12 * LANES + e]


@njit(cache=True, fastmath=True)
def unpose_tile(tile, lane, model, motion, band, gradients, by_motion):
    """``unpose_vertex`` for the vertices of ``tile`` (first, last) of LANES surfaces, read one by one."""
    first, last = tile
    pull = np.zeros((TILE, 3 * LANES), band.rest.dtype)
    work = np.empty(24 * LANES, band.rest.dtype)
    for s in range(min(LANES, len(gradients.vertices) - lane)):
        for i in range(last - first):
            for a in range(3):
                pull[i, a * LANES + s] = gradients.vertices[lane + s, first + i, a]
    for i in range(first, last):
        for e in range(3 * LANES):
            work[21 * LANES + e] = pull[i - first, e]
        unpose_vertex(i, lane, model, motion, band, work, by_motion, gradients.rest)


@njit(cache=True, parallel=True)
def unpose_many(model, motion, band, gradients):
    """``unpose_tile`` over all tiles of a band, of all surfaces; see ``BandGradients``."""
    count = band.last - band.first
    for split in prange(SPLITS):
        end = band.first + (split + 1) * count // SPLITS
        for block in range(len(motion)):
            for first in range(band.first + split * count // SPLITS, end, TILE):
                tile, by_motion = (first, min(first + TILE, end)), gradients.motion[split, block]
                unpose_tile(tile, block * LANES, model, motion[block], band, gradients, by_motion)
