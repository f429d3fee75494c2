"""Sparse times dense, in parallel: scipy's product runs on one core and was the largest part of a step."""

import numpy as np
from numba import njit, prange


@njit(cache=True, parallel=True)
def rows_of_blocks(indptr, indices, blocks, points, place, slopes):
    """Rows of a matrix of 3 x 3 blocks times slopes, and whether all that they need was there.

    ``points`` are the rows, and the slopes of point j stand at ``place[j]``; see ``SparseCurvature``.
    """
    width = slopes.shape[2]
    product = np.zeros((len(points), 3, width))
    missing = np.zeros(len(points), dtype=np.bool_)
    for r in prange(len(points)):
        i = points[r]
        for k in range(indptr[i], indptr[i + 1]):
            j = place[indices[k]]
            if j < 0:
                missing[r] = True
                continue
            for a in range(3):
                x, y, z = blocks[k, a, 0], blocks[k, a, 1], blocks[k, a, 2]
                for c in range(width):
                    product[r, a, c] += x * slopes[j, 0, c] + y * slopes[j, 1, c] + z * slopes[j, 2, c]
    return product, not missing.any()


@njit(cache=True, parallel=True)
def rows_per_axis(indptr, indices, data, points, place, slopes):
    """The same of a matrix that acts alike on x, y and z."""
    width = slopes.shape[2]
    product = np.zeros((len(points), 3, width))
    missing = np.zeros(len(points), dtype=np.bool_)
    for r in prange(len(points)):
        i = points[r]
        for k in range(indptr[i], indptr[i + 1]):
            j = place[indices[k]]
            if j < 0:
                missing[r] = True
                continue
            for a in range(3):
                for c in range(width):
                    product[r, a, c] += data[k] * slopes[j, a, c]
    return product, not missing.any()
