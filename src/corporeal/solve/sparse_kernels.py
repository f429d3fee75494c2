"""Up-looking sparse Cholesky (Davis 2006, "Direct Methods for Sparse Linear Systems", chapter 4)."""

import numpy as np
from numba import njit, prange


@njit(cache=True)
def reach(k, starts, rows, parent, mark, stack):
    """Columns of the factor that row k has entries in, in an order in which they can be eliminated."""
    top = len(parent)
    mark[k] = k
    for p in range(starts[k], starts[k + 1]):
        node, length = rows[p], 0
        while mark[node] != k:
            stack[length] = node
            length += 1
            mark[node] = k
            node = parent[node]
        while length > 0:
            length -= 1
            top -= 1
            stack[top] = stack[length]
    return top


@njit(cache=True)
def elimination_tree(starts, rows):
    size = len(starts) - 1
    parent, ancestor = np.full(size, -1), np.full(size, -1)
    for k in range(size):
        for p in range(starts[k], starts[k + 1]):
            node = rows[p]
            while node != -1 and node < k:
                following = ancestor[node]
                ancestor[node] = k
                if following == -1:
                    parent[node] = k
                node = following
    mark, stack, count = np.full(size, -1), np.empty(size, np.int64), np.ones(size + 1, np.int64)
    for k in range(size):
        for p in range(reach(k, starts, rows, parent, mark, stack), size):
            count[stack[p]] += 1
    factor_starts = np.zeros(size + 1, np.int64)
    for k in range(size):
        factor_starts[k + 1] = factor_starts[k] + count[k]
    return parent, factor_starts


@njit(cache=True)
def factorise(starts, rows, values, parent, factor_starts):
    """Rows and values of the factor by column, diagonal first; and the smallest pivot."""
    size = len(parent)
    factor_rows, factor = np.empty(factor_starts[size], np.int64), np.empty(factor_starts[size])
    filled = factor_starts[:size].copy()
    work, mark, stack = np.zeros(size), np.full(size, -1), np.empty(size, np.int64)
    smallest = np.inf
    for k in range(size):
        top = reach(k, starts, rows, parent, mark, stack)
        for p in range(starts[k], starts[k + 1]):
            work[rows[p]] = values[p]
        pivot, work[k] = work[k], 0.0
        for p in range(top, size):
            j = stack[p]
            entry = work[j] / factor[factor_starts[j]]
            work[j] = 0.0
            for q in range(factor_starts[j] + 1, filled[j]):
                work[factor_rows[q]] -= factor[q] * entry
            pivot -= entry * entry
            factor_rows[filled[j]], factor[filled[j]] = k, entry
            filled[j] += 1
        smallest = min(smallest, pivot)
        if not pivot > 0:
            return factor_rows, factor, pivot
        factor_rows[filled[k]], factor[filled[k]] = k, np.sqrt(pivot)
        filled[k] += 1
    return factor_rows, factor, smallest


@njit(cache=True, parallel=True)
def solve_in_place(factor_starts, factor_rows, factor, right, chunks):
    """Forward and backward substitution, chunks of columns in parallel."""
    size, width = right.shape
    for chunk in prange(chunks):
        low, high = chunk * width // chunks, (chunk + 1) * width // chunks
        part = right[:, low:high].copy()
        for j in range(size):
            pivot = 1.0 / factor[factor_starts[j]]
            for c in range(high - low):
                part[j, c] *= pivot
            for q in range(factor_starts[j] + 1, factor_starts[j + 1]):
                i, entry = factor_rows[q], factor[q]
                for c in range(high - low):
                    part[i, c] -= entry * part[j, c]
        for j in range(size - 1, -1, -1):
            for q in range(factor_starts[j] + 1, factor_starts[j + 1]):
                i, entry = factor_rows[q], factor[q]
                for c in range(high - low):
                    part[j, c] -= entry * part[i, c]
            pivot = 1.0 / factor[factor_starts[j]]
            for c in range(high - low):
                part[j, c] *= pivot
        right[:, low:high] = part
