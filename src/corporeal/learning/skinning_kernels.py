"""Kernels of learning: many registrations of many hands through one rig, in float64.

N registrations of H hands; V vertices, K joints. ``motions`` (N, K, 12) are what skinning blends: rotation to
the world row-major, then offset, translation included. ``weights`` is a tuple of the skinning weights by
vertex: starts (V + 1,), joints, values. ``chains`` is a tuple of the joints that move a vertex, ancestors
included, parents first: starts (V + 1,), joints.
"""

import numpy as np
from numba import njit, prange


@njit(cache=True, parallel=True)
def joint_motions(rotations, joints, hands, translations, parents, motions, placed):
    """Chain the joints of every registration; ``placed`` (N, K, 3) are their positions in the world."""
    for i in prange(len(rotations)):
        rest = joints[hands[i]]
        for k in range(len(parents)):
            p = parents[k]
            for a in range(3):
                for b in range(3):
                    turned = rotations[i, k, a, b]
                    if p >= 0:
                        turned = 0.0
                        for c in range(3):
                            turned += motions[i, p, 3 * a + c] * rotations[i, k, c, b]
                    motions[i, k, 3 * a + b] = turned
            for a in range(3):
                at = rest[k, a] + translations[i, a]
                if p >= 0:
                    at = motions[i, p, 9 + a]
                    for b in range(3):
                        at += motions[i, p, 3 * a + b] * rest[k, b]
                placed[i, k, a] = at
                offset = at
                for b in range(3):
                    offset -= motions[i, k, 3 * a + b] * rest[k, b]
                motions[i, k, 9 + a] = offset


@njit(cache=True, fastmath=True)
def blend(i, weights, motion, blended):
    starts, joints, values = weights
    blended[:] = 0.0
    for n in range(starts[i], starts[i + 1]):
        for e in range(12):
            blended[e] += values[n] * motion[joints[n], e]


@njit(cache=True, fastmath=True)
def posed(blended, rest, position):
    for a in range(3):
        position[a] = (
            blended[3 * a] * rest[0]
            + blended[3 * a + 1] * rest[1]
            + blended[3 * a + 2] * rest[2]
            + blended[9 + a]
        )


@njit(cache=True, parallel=True, fastmath=True)
def squared_errors(weights, motions, rest, vertices, errors):
    """Sum over the vertices of the squared distances (n,)."""
    for i in prange(len(motions)):
        blended, at = np.empty(12), np.empty(3)
        total = 0.0
        for v in range(rest.shape[1]):
            blend(v, weights, motions[i], blended)
            posed(blended, rest[i, v], at)
            for a in range(3):
                total += (vertices[i, v, a] - at[a]) ** 2
        errors[i] = total


@njit(cache=True, parallel=True, fastmath=True)
def posed_vertices(weights, motions, rest, vertices):
    """Fill ``vertices`` (n, V, 3)."""
    for i in prange(len(motions)):
        blended = np.empty(12)
        for v in range(rest.shape[1]):
            blend(v, weights, motions[i], blended)
            posed(blended, rest[i, v], vertices[i, v])


@njit(cache=True, fastmath=True)
def carry(v, weights, motion, rest, carried):
    """What every joint carries of a vertex: weighted position, and weight."""
    starts, joints, values = weights
    for n in range(starts[v], starts[v + 1]):
        k, w = joints[n], values[n]
        for a in range(3):
            at = motion[k, 3 * a] * rest[0] + motion[k, 3 * a + 1] * rest[1] + motion[k, 3 * a + 2] * rest[2]
            carried[k, a] = w * (at + motion[k, 9 + a])
        carried[k, 3] = w


@njit(cache=True, fastmath=True)
def levers(v, chains, parents, placed, carried, arms, position):
    """Arms of every joint of the chain about its place, children first; ``carried`` is zero afterwards."""
    starts, joints = chains
    for n in range(starts[v + 1] - 1, starts[v] - 1, -1):
        m = joints[n]
        for a in range(3):
            arms[n - starts[v], a] = carried[m, a] - carried[m, 3] * placed[m, a]
        p = parents[m]
        for a in range(4):
            if p >= 0:
                carried[p, a] += carried[m, a]
            elif a < 3:
                position[a] = carried[m, a]
            carried[m, a] = 0.0


@njit(cache=True, fastmath=True)
def add_levers(members, arms, residual, products, sums, turns):
    """Outer products, sums and torques of one vertex: all that the normal equations are made of."""
    count = len(members)
    for s in range(count):
        m = members[s]
        x, y, z = arms[s, 0], arms[s, 1], arms[s, 2]
        sums[m, 0] += x
        sums[m, 1] += y
        sums[m, 2] += z
        turns[m, 0] += y * residual[2] - z * residual[1]
        turns[m, 1] += z * residual[0] - x * residual[2]
        turns[m, 2] += x * residual[1] - y * residual[0]
        for t in range(s, count):
            block = products[m, members[t]]
            for b in range(3):
                block[0, b] += x * arms[t, b]
                block[1, b] += y * arms[t, b]
                block[2, b] += z * arms[t, b]


@njit(cache=True, parallel=True, fastmath=True)
def pose_moments(weights, chains, parents, motions, placed, rest, vertices, moments):
    """Moments of the arms for the normal equations of every pose.

    ``moments`` is a tuple: products (n, K, K, 3, 3) of arms (upper joints only), sums (n, K, 3), turns (n, K,
    3), pull (n, 3) and errors (n,).
    """
    products, sums, turns, pull, errors = moments
    starts, joints = chains
    K = len(parents)
    for i in prange(len(motions)):
        carried, arms = np.zeros((K, 4)), np.empty((K, 3))
        at, residual = np.empty(3), np.empty(3)
        products[i], sums[i], turns[i], pull[i], errors[i] = 0.0, 0.0, 0.0, 0.0, 0.0
        for v in range(rest.shape[1]):
            carry(v, weights, motions[i], rest[i, v], carried)
            levers(v, chains, parents, placed[i], carried, arms, at)
            for a in range(3):
                residual[a] = vertices[i, v, a] - at[a]
                pull[i, a] += residual[a]
                errors[i] += residual[a] ** 2
            add_levers(joints[starts[v] : starts[v + 1]], arms, residual, products[i], sums[i], turns[i])


@njit(cache=True, parallel=True, fastmath=True)
def template_moments(weights, motions, offsets, vertices, importance, hands, squares, pulls):
    """Normal equations of every hand's template, vertex by vertex.

    ``offsets`` (n, V, 3) are the pose correctives, ``importance`` (n,) weighs registrations, ``hands`` (n,)
    says whose they are. Adds to ``squares`` (H, V, 6), the upper triangle of A^T A, and ``pulls`` (H, V, 3).
    """
    for v in prange(vertices.shape[1]):
        blended, at, residual = np.empty(12), np.empty(3), np.empty(3)
        for i in range(len(motions)):
            blend(v, weights, motions[i], blended)
            posed(blended, offsets[i, v], at)
            for a in range(3):
                residual[a] = importance[i] * (vertices[i, v, a] - at[a])
            square, pull = squares[hands[i], v], pulls[hands[i], v]
            e = 0
            for a in range(3):
                for b in range(a, 3):
                    dot = (
                        blended[a] * blended[b]
                        + blended[3 + a] * blended[3 + b]
                        + blended[6 + a] * blended[6 + b]
                    )
                    square[e] += importance[i] * dot
                    e += 1
                pull[a] += (
                    blended[a] * residual[0] + blended[3 + a] * residual[1] + blended[6 + a] * residual[2]
                )


@njit(cache=True, parallel=True, fastmath=True)
def unposed_pull(weights, motions, rest, vertices, pull):
    """A^T (vertices - posed rest) into ``pull`` (n, V, 3): the gradient in the frame of the zero pose."""
    for i in prange(len(motions)):
        blended, at = np.empty(12), np.empty(3)
        for v in range(rest.shape[1]):
            blend(v, weights, motions[i], blended)
            posed(blended, rest[i, v], at)
            for a in range(3):
                at[a] = vertices[i, v, a] - at[a]
            for a in range(3):
                pull[i, v, a] = blended[a] * at[0] + blended[3 + a] * at[1] + blended[6 + a] * at[2]


@njit(cache=True, parallel=True, fastmath=True)
def apply_metric(weights, motions, offsets):
    """Replace offsets (n, V, 3) of the zero pose by A^T A offsets."""
    for i in prange(len(motions)):
        blended, at = np.empty(12), np.empty(3)
        for v in range(offsets.shape[1]):
            blend(v, weights, motions[i], blended)
            x, y, z = offsets[i, v]
            for a in range(3):
                at[a] = blended[3 * a] * x + blended[3 * a + 1] * y + blended[3 * a + 2] * z
            for a in range(3):
                offsets[i, v, a] = blended[a] * at[0] + blended[3 + a] * at[1] + blended[6 + a] * at[2]


@njit(cache=True, parallel=True, fastmath=True)
def weight_moments(candidates, motions, rest, vertices, squares):
    """Quadratic form of every vertex's weights over its candidate joints: the error is w^T S w, since they
    sum to one.

    ``candidates`` (V, C) are joints, -1 where there are fewer. Adds to the lower triangles of ``squares`` (V,
    C, C).
    """
    C = candidates.shape[1]
    for v in prange(len(candidates)):
        places = np.empty((C, 3))
        for i in range(len(motions)):
            x, y, z = rest[i, v]
            for c in range(C):
                k = candidates[v, c]
                if k < 0:
                    break
                motion = motions[i, k]
                for a in range(3):
                    at = motion[3 * a] * x + motion[3 * a + 1] * y + motion[3 * a + 2] * z + motion[9 + a]
                    places[c, a] = at - vertices[i, v, a]
                for d in range(c + 1):
                    dot = 0.0
                    for a in range(3):
                        dot += places[c, a] * places[d, a]
                    squares[v, c, d] += dot


@njit(cache=True)
def smallest_form(square, count, chosen, size, weights):
    """The ``chosen`` candidates' weights that sum to one and make the form least; False if one is negative"""
    system, right = np.zeros((size + 1, size + 1)), np.zeros(size + 1)
    for s in range(size):
        for t in range(size):
            system[s, t] = square[chosen[s], chosen[t]]
        system[s, size] = system[size, s] = 1.0
        right[s] = square[chosen[s], count]
    right[size] = 1.0
    solved = np.linalg.solve(system, right)
    weights[:] = 0.0
    for s in range(size):
        if solved[s] < 0:
            return False
        weights[chosen[s]] = solved[s]
    return True


@njit(cache=True)
def form_value(square, count, weights):
    total = 0.0
    for s in range(count):
        total -= 2 * square[s, count] * weights[s]
        for t in range(count):
            total += square[s, t] * weights[s] * weights[t]
    return total


@njit(cache=True, parallel=True)
def best_weights(squares, counts, most, weights):
    """The best weights with at most ``most`` joints, by trying every set of candidates.

    ``squares`` (V, C, C + 1) hold the quadratic form and, in the column after the last candidate, the linear
    part; ``weights`` (V, C) come as a feasible guess and leave as the best.
    """
    C = squares.shape[1]
    for v in prange(len(squares)):
        count = counts[v]
        best = form_value(squares[v], count, weights[v])
        tried, chosen = np.zeros(C), np.empty(C, np.int64)
        for subset in range(1, 1 << count):
            size = 0
            for c in range(count):
                if subset >> c & 1:
                    chosen[size] = c
                    size += 1
            if size <= most and smallest_form(squares[v], count, chosen, size, tried):
                value = form_value(squares[v], count, tried)
                if value < best:
                    best = value
                    weights[v] = tried
