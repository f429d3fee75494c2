"""Kernels that ask a surface tree for closest points; its layout is told in ``surface_tree_kernels``."""

import numpy as np
from numba import njit, prange

# Children of a node. 16 boxes are two vectors of AVX2 or one of AVX-512, and a loop of 16 is the shortest
# that LLVM vectorises. Measured: with 4 and 8 children answers take 1.2 times as long and building 1.3 times.
WIDTH = 16
EMPTY = np.int32(-2147483648)  # no child
# A squared distance to a box is taken this much smaller: more than its float32 arithmetic can be wrong for
# points outside the mesh's cube; inside, the boxes' PAD does the same.
SHRINK = np.float32(1 - 4e-6)
CHUNK = 256
ZERO = np.float32(0)
CELLS = 32  # per axis, of the grid that sorts points
SLIVER = 1e-4  # squared sine of the angle at corner a, below which the regions' signs lose too many digits


@njit(cache=True, error_model="numpy")
def closest_on_segment(px, py, pz, ex, ey, ez, ee):
    """Place in [0, 1] along an edge from the origin that is closest to a point, and the squared distance."""
    s = 0.0
    if ee > 0:
        s = min(max((px * ex + py * ey + pz * ez) / ee, 0.0), 1.0)
    x, y, z = px - s * ex, py - s * ey, pz - s * ez
    return s, x * x + y * y + z * z


@njit(cache=True, error_model="numpy")
def closest_inside_sliver(px, py, pz, row):
    """The foot on the plane, or corner a, by Gram-Schmidt: it keeps the digits that determinants lose."""
    ax, ay, az, bx, by, bz = row[3], row[4], row[5], row[6], row[7], row[8]
    aa, bb = row[9], row[11]
    swapped = bb > aa
    if swapped:
        ax, ay, az, bx, by, bz, aa = bx, by, bz, ax, ay, az, bb
    v, w = 0.0, 0.0
    if aa > 0:
        along = row[10] / aa
        hx, hy, hz = bx - along * ax, by - along * ay, bz - along * az
        again = (hx * ax + hy * ay + hz * az) / aa
        hx, hy, hz = hx - again * ax, hy - again * ay, hz - again * az
        w = (px * hx + py * hy + pz * hz) / (hx * hx + hy * hy + hz * hz)
        v = (px * ax + py * ay + pz * az) / aa - w * (along + again)
        if not (v >= 0 and w >= 0 and v + w <= 1):
            v, w = 0.0, 0.0
    rx, ry, rz = px - v * ax - w * bx, py - v * ay - w * by, pz - v * az - w * bz
    squared = rx * rx + ry * ry + rz * rz
    if swapped:
        return w, v, squared
    return v, w, squared


@njit(cache=True, error_model="numpy")
def closest_on_sliver(px, py, pz, row):
    """The best of the foot inside and the three edges, for triangles (almost) without area."""
    v, w, squared = closest_inside_sliver(px, py, pz, row)
    s, here = closest_on_segment(px, py, pz, row[3], row[4], row[5], row[9])
    if here < squared:
        v, w, squared = s, 0.0, here
    s, here = closest_on_segment(px, py, pz, row[6], row[7], row[8], row[11])
    if here < squared:
        v, w, squared = 0.0, s, here
    bx, by, bz = row[6] - row[3], row[7] - row[4], row[8] - row[5]
    bb = bx * bx + by * by + bz * bz
    s, here = closest_on_segment(px - row[3], py - row[4], pz - row[5], bx, by, bz, bb)
    if here < squared:
        v, w, squared = 1.0 - s, s, here
    return v, w, squared


@njit(cache=True, error_model="numpy")
def closest_on_triangle(x, y, z, row):
    """Weights v and w of corners b and c of the closest point, and its squared distance.

    The seven regions are told apart as in Ericson 2005, "Real-Time Collision Detection", section 5.1.5.
    """
    px, py, pz = x - row[0], y - row[1], z - row[2]
    ab, cross, ac = row[9], row[10], row[11]
    if ab * ac - cross * cross <= SLIVER * ab * ac:
        return closest_on_sliver(px, py, pz, row)
    d1 = row[3] * px + row[4] * py + row[5] * pz
    d2 = row[6] * px + row[7] * py + row[8] * pz
    d3, d4, d5, d6 = d1 - ab, d2 - cross, d1 - cross, d2 - ac
    va = d3 * d6 - d5 * d4
    vb = d5 * d2 - d1 * d6
    vc = d1 * d4 - d3 * d2
    v, w = 0.0, 0.0
    if d1 <= 0 and d2 <= 0:
        pass
    elif d3 >= 0 and d4 <= d3:
        v = 1.0
    elif d6 >= 0 and d5 <= d6:
        w = 1.0
    elif vc <= 0 and d1 >= 0 and d3 <= 0:
        v = d1 / ab
    elif vb <= 0 and d2 >= 0 and d6 <= 0:
        w = d2 / ac
    elif va <= 0 and d4 >= d3 and d5 >= d6:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        v = 1.0 - w
    else:
        total = va + vb + vc
        v = vb / total
        w = vc / total
    rx = px - v * row[3] - w * row[6]
    ry = py - v * row[4] - w * row[7]
    rz = pz - v * row[5] - w * row[8]
    return v, w, rx * rx + ry * ry + rz * rz


@njit(cache=True, error_model="numpy")
def gap(low, high, x):
    """Distance from x to an interval; comparisons in this form become single instructions."""
    below, above = low - x, x - high
    outside = below if below > above else above
    return outside if outside > ZERO else ZERO


@njit(cache=True, error_model="numpy")
def query(x, y, z, start, tree, scratch):
    """Closest triangle (leaf order) of one point, its weights v and w, and the squared distance."""
    triangles, order, children, boxes, centre, scale = tree
    stack, stack_distances, distances = scratch
    best = start
    v, w, squared = closest_on_triangle(x, y, z, triangles[start])
    bound = np.float32(squared * scale * scale)
    cx = np.float32((x - centre[0]) * scale)
    cy = np.float32((y - centre[1]) * scale)
    cz = np.float32((z - centre[2]) * scale)
    stack[0], stack_distances[0] = 0, ZERO
    top = 1
    while top > 0:
        top -= 1
        if stack_distances[top] > bound:
            continue
        node = stack[top]
        for k in range(WIDTH):
            gx = gap(boxes[node, 0, k], boxes[node, 3, k], cx)
            gy = gap(boxes[node, 1, k], boxes[node, 4, k], cy)
            gz = gap(boxes[node, 2, k], boxes[node, 5, k], cz)
            distances[k] = (gx * gx + gy * gy + gz * gz) * SHRINK
        bottom = top
        for k in range(WIDTH):
            near = distances[k]
            child = children[node, k]
            if near > bound or child == EMPTY:
                continue
            if child >= 0:
                # The nearest child lies on top of the stack and is looked at first.
                place = top
                while place > bottom and stack_distances[place - 1] < near:
                    stack[place], stack_distances[place] = stack[place - 1], stack_distances[place - 1]
                    place -= 1
                stack[place], stack_distances[place] = child, near
                top += 1
            else:
                t = ~child
                tv, tw, here = closest_on_triangle(x, y, z, triangles[t])
                if here < squared or (here == squared and order[t] < order[best]):
                    best, v, w, squared = t, tv, tw, here
                    bound = np.float32(squared * scale * scale)
    return best, v, w, squared


@njit(cache=True, error_model="numpy")
def query_some(points, sequence, starts, tree, stack_size, out):
    """Closest points of points[sequence]; without a start, the last point's triangle is the first bound."""
    faces, barycentric, squared_distances = out
    scratch = (
        np.empty(stack_size, np.int64),
        np.empty(stack_size, np.float32),
        np.empty(WIDTH, np.float32),
    )
    last = 0
    for i in sequence:
        start = starts[i] if starts[i] >= 0 else last
        last, v, w, squared = query(points[i, 0], points[i, 1], points[i, 2], start, tree, scratch)
        faces[i] = tree[1][last]
        barycentric[i, 0] = max(1.0 - v - w, 0.0)
        barycentric[i, 1] = v
        barycentric[i, 2] = w
        squared_distances[i] = squared


@njit(cache=True, parallel=True, error_model="numpy")
def query_many(points, sequence, starts, tree, stack_size, out):
    """The same as ``query_some``, on all cores."""
    N = len(sequence)
    for chunk in prange((N + CHUNK - 1) // CHUNK):
        part = sequence[chunk * CHUNK : min(N, (chunk + 1) * CHUNK)]
        query_some(points, part, starts, tree, stack_size, out)


@njit(cache=True)
def spread_bits(value):
    """Put two empty bits between the (at most 10) bits of a number."""
    value = (value | (value << 16)) & 0x030000FF
    value = (value | (value << 8)) & 0x0300F00F
    value = (value | (value << 4)) & 0x030C30C3
    return (value | (value << 2)) & 0x09249249


@njit(cache=True, error_model="numpy")
def cell_keys(points, centre, scale):
    """Place of every point's cell on a Morton curve through the mesh's cube; outside is on the border."""
    keys = np.empty(len(points), np.int64)
    for i in range(len(points)):
        key = 0
        for d in range(3):
            place = ((points[i, d] - centre[d]) * scale + 1.0) * (0.5 * CELLS)
            key |= spread_bits(int(min(max(place, 0.0), CELLS - 1.0))) << d
        keys[i] = key
    return keys


@njit(cache=True)
def counting_order(keys, count):
    """Indices that sort keys in [0, count), stable."""
    begins = np.zeros(count + 1, np.int64)
    for key in keys:
        begins[key + 1] += 1
    for k in range(count):
        begins[k + 1] += begins[k]
    sequence = np.empty(len(keys), np.int64)
    for i in range(len(keys)):
        sequence[begins[keys[i]]] = i
        begins[keys[i]] += 1
    return sequence


@njit(cache=True, error_model="numpy")
def interpolate(vertices, faces, chosen, barycentric):
    """Points of the surface from their faces and weights."""
    points = np.empty((len(chosen), 3))
    for i in range(len(chosen)):
        a, b, c = faces[chosen[i], 0], faces[chosen[i], 1], faces[chosen[i], 2]
        for d in range(3):
            points[i, d] = (
                barycentric[i, 0] * vertices[a, d]
                + barycentric[i, 1] * vertices[b, d]
                + barycentric[i, 2] * vertices[c, d]
            )
    return points
