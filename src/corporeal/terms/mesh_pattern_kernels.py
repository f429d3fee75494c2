"""Scatter-add of per-point quadratics onto the mesh; serial, so that the sums are the same in every run."""

import numpy as np
from numba import njit


@njit(cache=True)
def scatter_gradient(faces, face, barycentric, vectors, vertex_count):
    gradient = np.zeros((vertex_count, 3))
    for i in range(len(face)):
        for a in range(3):
            vertex, share = faces[face[i], a], barycentric[i, a]
            for axis in range(3):
                gradient[vertex, axis] += share * vectors[i, axis]
    return gradient


@njit(cache=True)
def scatter_per_axis(slots, face, barycentric, weight, size):
    data = np.zeros(size)
    for i in range(len(face)):
        for a in range(3):
            for b in range(3):
                data[slots[face[i], 3 * a + b]] += weight[i] * barycentric[i, a] * barycentric[i, b]
    return data


@njit(cache=True)
def scatter_blocks(slots, face, barycentric, metric, size):
    data = np.zeros((size, 3, 3))
    for i in range(len(face)):
        for a in range(3):
            for b in range(3):
                slot, share = slots[face[i], 3 * a + b], barycentric[i, a] * barycentric[i, b]
                for row in range(3):
                    for column in range(3):
                        data[slot, row, column] += share * metric[i, row, column]
    return data
