"""Stable neo-Hookean elasticity on tetrahedra and frictionless contact.

One thread: sessions run a process per core.
"""

import numpy as np
from numba import njit


@njit(cache=True)
def elastic_forces(x, tets, inverse_rest, volumes, mu, lam, gradient):
    """Energy of Smith, de Goes and Kim 2018 (equation 14), its gradient added in place, smallest det F."""
    alpha = 1.0 + mu / lam - mu / (4.0 * lam)
    energy, smallest = 0.0, np.inf
    for e in range(len(tets)):
        d, a, b, c = tets[e]
        m = inverse_rest[e]
        p00, p01, p02 = x[a, 0] - x[d, 0], x[b, 0] - x[d, 0], x[c, 0] - x[d, 0]
        p10, p11, p12 = x[a, 1] - x[d, 1], x[b, 1] - x[d, 1], x[c, 1] - x[d, 1]
        p20, p21, p22 = x[a, 2] - x[d, 2], x[b, 2] - x[d, 2], x[c, 2] - x[d, 2]
        f00 = p00 * m[0, 0] + p01 * m[1, 0] + p02 * m[2, 0]
        f01 = p00 * m[0, 1] + p01 * m[1, 1] + p02 * m[2, 1]
        f02 = p00 * m[0, 2] + p01 * m[1, 2] + p02 * m[2, 2]
        f10 = p10 * m[0, 0] + p11 * m[1, 0] + p12 * m[2, 0]
        f11 = p10 * m[0, 1] + p11 * m[1, 1] + p12 * m[2, 1]
        f12 = p10 * m[0, 2] + p11 * m[1, 2] + p12 * m[2, 2]
        f20 = p20 * m[0, 0] + p21 * m[1, 0] + p22 * m[2, 0]
        f21 = p20 * m[0, 1] + p21 * m[1, 1] + p22 * m[2, 1]
        f22 = p20 * m[0, 2] + p21 * m[1, 2] + p22 * m[2, 2]
        # Columns of the cofactor matrix are the cross products of the other two columns of F.
        k00, k10, k20 = f11 * f22 - f21 * f12, f21 * f02 - f01 * f22, f01 * f12 - f11 * f02
        k01, k11, k21 = f12 * f20 - f22 * f10, f22 * f00 - f02 * f20, f02 * f10 - f12 * f00
        k02, k12, k22 = f10 * f21 - f20 * f11, f20 * f01 - f00 * f21, f00 * f11 - f10 * f01
        det = f00 * k00 + f10 * k10 + f20 * k20
        smallest = min(smallest, det)
        square = f00 * f00 + f01 * f01 + f02 * f02 + f10 * f10 + f11 * f11 + f12 * f12
        square += f20 * f20 + f21 * f21 + f22 * f22
        volume = volumes[e]
        energy += volume * (
            0.5 * mu * (square - 3.0) + 0.5 * lam * (det - alpha) ** 2 - 0.5 * mu * np.log(square + 1.0)
        )
        s, t = volume * mu * (1.0 - 1.0 / (square + 1.0)), volume * lam * (det - alpha)
        q00, q01, q02 = s * f00 + t * k00, s * f01 + t * k01, s * f02 + t * k02
        q10, q11, q12 = s * f10 + t * k10, s * f11 + t * k11, s * f12 + t * k12
        q20, q21, q22 = s * f20 + t * k20, s * f21 + t * k21, s * f22 + t * k22
        for i in range(3):
            g0 = q00 * m[i, 0] + q01 * m[i, 1] + q02 * m[i, 2]
            g1 = q10 * m[i, 0] + q11 * m[i, 1] + q12 * m[i, 2]
            g2 = q20 * m[i, 0] + q21 * m[i, 1] + q22 * m[i, 2]
            v = tets[e, i + 1]
            gradient[v, 0] += g0
            gradient[v, 1] += g1
            gradient[v, 2] += g2
            gradient[d, 0] -= g0
            gradient[d, 1] -= g1
            gradient[d, 2] -= g2
    return energy, smallest


@njit(cache=True)
def contact_forces(x, vertices, triangles, barycentric, normals, stiffness, thickness, gradient):
    """Energy of vertices nearer than ``thickness`` to a face across a gap; its gradient is added in place."""
    energy = 0.0
    for p in range(len(vertices)):
        v = vertices[p]
        distance = 0.0
        for a in range(3):
            on_face = 0.0
            for i in range(3):
                on_face += barycentric[p, i] * x[triangles[p, i], a]
            distance += normals[p, a] * (x[v, a] - on_face)
        depth = thickness - distance
        if depth <= 0.0:
            continue
        energy += 0.5 * stiffness[p] * depth * depth
        for a in range(3):
            push = -stiffness[p] * depth * normals[p, a]
            gradient[v, a] += push
            for i in range(3):
                gradient[triangles[p, i], a] -= barycentric[p, i] * push
    return energy


@njit(cache=True)
def squared_distance(a, b):
    return (a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2


@njit(cache=True)
def closest_on_triangle(p, a, b, c):
    """Barycentric weights of the point of a triangle closest to p (Ericson 2005, 5.1.5)."""
    ab, ac, ap = b - a, c - a, p - a
    d1, d2 = ab @ ap, ac @ ap
    if d1 <= 0.0 and d2 <= 0.0:
        return 1.0, 0.0, 0.0
    bp = p - b
    d3, d4 = ab @ bp, ac @ bp
    if d3 >= 0.0 and d4 <= d3:
        return 0.0, 1.0, 0.0
    vc = d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        v = d1 / (d1 - d3)
        return 1.0 - v, v, 0.0
    cp = p - c
    d5, d6 = ab @ cp, ac @ cp
    if d6 >= 0.0 and d5 <= d6:
        return 0.0, 0.0, 1.0
    vb = d5 * d2 - d1 * d6
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        w = d2 / (d2 - d6)
        return 1.0 - w, 0.0, w
    va = d3 * d6 - d5 * d4
    if va <= 0.0 and (d4 - d3) >= 0.0 and (d5 - d6) >= 0.0:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        return 0.0, 1.0 - w, w
    scale = 1.0 / (va + vb + vc)
    return 1.0 - (vb + vc) * scale, vb * scale, vc * scale


@njit(cache=True)
def cell_lists(points, low, size, shape):
    """Points sorted into the cells of a grid: the start of every cell's list, and the list."""
    cells = np.empty(len(points), np.int64)
    count = np.zeros(shape[0] * shape[1] * shape[2] + 1, np.int64)
    for i in range(len(points)):
        cell = 0
        for a in range(3):
            cell = cell * shape[a] + int((points[i, a] - low[a]) / size)
        cells[i] = cell
        count[cell + 1] += 1
    starts = np.cumsum(count)
    filled = starts[:-1].copy()
    members = np.empty(len(points), np.int64)
    for i in range(len(points)):
        members[filled[cells[i]]] = i
        filled[cells[i]] += 1
    return starts, members


@njit(cache=True)
def contact_pairs(skin, points, normals, gaps, reach, grid):
    """For every surface point, the nearest face of skin that is far from it at rest and looks against it.

    Within one part (a finger, the palm) only skin that looked the same way at rest can meet: palm side on
    palm side in a crease. Its far side is no neighbour across a gap, however thin the part is squeezed.


    Returns the face (-1 where there is none within reach) and the barycentric weights of the closest point.
    """
    rest, rest_normals, parts, face_starts, face_lists, faces = skin
    low, shape, starts, members = grid
    found = np.full(len(points), -1)
    weights = np.zeros((len(points), 3))
    for i in range(len(points)):
        nearest, best = -1, reach * reach
        cell = ((points[i] - low) / reach).astype(np.int64)
        for cx in range(max(cell[0] - 1, 0), min(cell[0] + 2, shape[0])):
            for cy in range(max(cell[1] - 1, 0), min(cell[1] + 2, shape[1])):
                for cz in range(max(cell[2] - 1, 0), min(cell[2] + 2, shape[2])):
                    key = (cx * shape[1] + cy) * shape[2] + cz
                    for m in range(starts[key], starts[key + 1]):
                        j = members[m]
                        gap = squared_distance(points[i], points[j])
                        same_part = parts[i] == parts[j]
                        apart = gaps[0] if same_part else gaps[1]
                        if gap >= best or squared_distance(rest[i], rest[j]) < apart * apart:
                            continue
                        through = same_part and rest_normals[i] @ rest_normals[j] < 0.0
                        if not through and normals[i] @ normals[j] <= 0.3:
                            nearest, best = j, gap
        if nearest < 0:
            continue
        best = np.inf
        for k in range(face_starts[nearest], face_starts[nearest + 1]):
            f = face_lists[k]
            a, b, c = faces[f]
            u, v, w = closest_on_triangle(points[i], points[a], points[b], points[c])
            off = points[i] - u * points[a] - v * points[b] - w * points[c]
            if off @ off < best:
                best, found[i] = off @ off, f
                weights[i, 0], weights[i, 1], weights[i, 2] = u, v, w
    return found, weights
