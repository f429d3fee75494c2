"""Kernels that build and refit a surface tree, a wide bounding-volume hierarchy over triangles.

Layout. Triangles stand in leaf order: (F, 12) rows of corner a, edges ab and ac, then ab·ab, ab·ac, ac·ac. A
node holds the boxes of its W children side by side, (6, W) float32: lower x y z, upper x y z. Its children
are (W,) int32: a node, or ``~t`` for triangle t, or nothing: ``~t`` for a t beyond the last triangle. Parents
stand before their children. W is read from the arrays here: numba's cache does not notice a constant that has
changed in another file, so only the module that needs it as a constant, to vectorise, holds it.

Boxes are in coordinates that put the mesh into the cube [-1, 1], and are grown by PAD. That covers every
rounding of the float32 arithmetic in a query (which adds its own margin for far points): a box never hides
the closest triangle.
"""

import numpy as np
from numba import njit, prange

PAD = np.float32(1e-6)
INFINITE = np.float32(np.inf)
BINS = 16


@njit(cache=True, error_model="numpy")
def triangle_boxes(vertices, faces):
    """Box (6,) and centre (3,) of every face."""
    limits = np.empty((len(faces), 6))
    centres = np.empty((len(faces), 3))
    for f in range(len(faces)):
        for d in range(3):
            a, b, c = vertices[faces[f, 0], d], vertices[faces[f, 1], d], vertices[faces[f, 2], d]
            limits[f, d] = min(a, b, c)
            limits[f, 3 + d] = max(a, b, c)
            centres[f, d] = 0.5 * limits[f, d] + 0.5 * limits[f, 3 + d]
    return limits, centres


@njit(cache=True, error_model="numpy")
def empty_box(box):
    """Make a box that holds nothing."""
    for d in range(3):
        box[d] = np.inf
        box[3 + d] = -np.inf


@njit(cache=True, error_model="numpy")
def grow(box, other):
    """Extend a box to hold another."""
    for d in range(3):
        box[d] = min(box[d], other[d])
        box[3 + d] = max(box[3 + d], other[3 + d])


@njit(cache=True, error_model="numpy")
def half_area(box):
    """Half the surface of a box; zero for an empty one."""
    if box[3] < box[0]:
        return 0.0
    x, y, z = box[3] - box[0], box[4] - box[1], box[5] - box[2]
    return x * y + y * z + z * x


@njit(cache=True, error_model="numpy")
def centre_box(centres, order, begin, end):
    """Box of the centres of order[begin:end]."""
    box = np.empty(6)
    empty_box(box)
    for i in range(begin, end):
        for d in range(3):
            value = centres[order[i], d]
            box[d] = min(box[d], value)
            box[3 + d] = max(box[3 + d], value)
    return box


@njit(cache=True, error_model="numpy")
def cheapest_cut(bin_count, bin_box, right_cost):
    """Last bin of the first part by the surface-area heuristic; -1 if nothing can be cut."""
    box = np.empty(6)
    empty_box(box)
    total = 0
    for b in range(len(bin_count) - 1, -1, -1):
        total += bin_count[b]
        grow(box, bin_box[b])
        right_cost[b] = total * half_area(box)
    empty_box(box)
    best, best_cost = -1, np.inf
    here = 0
    for b in range(len(bin_count) - 1):
        here += bin_count[b]
        grow(box, bin_box[b])
        cost = here * half_area(box) + right_cost[b + 1]
        if 0 < here < total and cost < best_cost:
            best, best_cost = b, cost
    return best


@njit(cache=True, error_model="numpy")
def split(limits, centres, order, begin, end):
    """Partition order[begin:end] in two by the binned surface-area heuristic; the second's begin.

    Across the longest axis: with the cheapest of all three a build took 1.4 times as long, answers the same.
    """
    extent = centre_box(centres, order, begin, end)
    axis = np.argmax(extent[3:] - extent[:3])
    halves = begin + (end - begin) // 2
    if not extent[3 + axis] > extent[axis]:
        return halves  # all centres coincide
    scale = BINS / (extent[3 + axis] - extent[axis])
    bin_count = np.zeros(BINS, np.int64)
    bin_box = np.empty((BINS, 6))
    for b in range(BINS):
        empty_box(bin_box[b])
    for i in range(begin, end):
        t = order[i]
        b = min(int((centres[t, axis] - extent[axis]) * scale), BINS - 1)
        bin_count[b] += 1
        grow(bin_box[b], limits[t])
    cut = cheapest_cut(bin_count, bin_box, np.empty(BINS))
    if cut < 0:
        return halves
    left, right = begin, end - 1
    while left <= right:
        b = min(int((centres[order[left], axis] - extent[axis]) * scale), BINS - 1)
        if b <= cut:
            left += 1
        else:
            order[left], order[right] = order[right], order[left]
            right -= 1
    return left


@njit(cache=True, error_model="numpy")
def cut_range(limits, centres, order, cuts):
    """Cut the range cuts[0]:cuts[1] into at most len(cuts) - 1 parts; returns their number, fills ``cuts``.

    The most numerous part is cut first. A part that fits into one node is left whole, so that the lowest
    nodes are full: cutting on to single triangles made three times as many nodes, a quarter full.
    """
    width = len(cuts) - 1
    enough = width if cuts[1] - cuts[0] > width else 1
    parts = 1
    while parts < width:
        widest = 0
        for r in range(1, parts):
            if cuts[r + 1] - cuts[r] > cuts[widest + 1] - cuts[widest]:
                widest = r
        if cuts[widest + 1] - cuts[widest] <= enough:
            break
        if enough == 1:
            middle = cuts[widest] + 1  # all triangles become children: their order does not matter
        else:
            middle = split(limits, centres, order, cuts[widest], cuts[widest + 1])
        for r in range(parts, widest, -1):
            cuts[r + 1] = cuts[r]
        cuts[widest + 1] = middle
        parts += 1
    return parts


@njit(cache=True, error_model="numpy")
def build(limits, centres, order, children):
    """Fill ``order`` (leaf order of the faces) and ``children``, which come empty; node count and depth."""
    F = len(limits)
    for f in range(F):
        order[f] = f
    begins = np.empty(len(children), np.int64)
    ends = np.empty(len(children), np.int64)
    levels = np.empty(len(children), np.int64)
    cuts = np.empty(children.shape[1] + 1, np.int64)
    begins[0], ends[0], levels[0] = 0, F, 1
    nodes, node = 1, 0
    while node < nodes:
        cuts[0], cuts[1] = begins[node], ends[node]
        parts = cut_range(limits, centres, order, cuts)
        for k in range(parts):
            if cuts[k + 1] - cuts[k] == 1:
                children[node, k] = ~cuts[k]
            else:
                children[node, k] = nodes
                begins[nodes], ends[nodes], levels[nodes] = cuts[k], cuts[k + 1], levels[node] + 1
                nodes += 1
        node += 1
    return nodes, levels[nodes - 1]


@njit(cache=True, parallel=True, error_model="numpy")
def gather_triangles(vertices, faces, order, triangles):
    """Write the triangles in leaf order; returns the area of the surface."""
    area = 0.0
    for t in prange(len(order)):
        f = order[t]
        i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
        row = triangles[t]
        for d in range(3):
            row[d] = vertices[i, d]
            row[3 + d] = vertices[j, d] - vertices[i, d]
            row[6 + d] = vertices[k, d] - vertices[i, d]
        row[9] = row[3] * row[3] + row[4] * row[4] + row[5] * row[5]
        row[10] = row[3] * row[6] + row[4] * row[7] + row[5] * row[8]
        row[11] = row[6] * row[6] + row[7] * row[7] + row[8] * row[8]
        area += 0.5 * np.sqrt(max(row[9] * row[11] - row[10] * row[10], 0.0))
    return area


@njit(cache=True, error_model="numpy")
def fit_boxes(triangles, children, boxes, centre, scale):
    """Boxes of all nodes from the triangles; returns the summed half area of the inner nodes' boxes."""
    total = 0.0
    for node in range(len(children) - 1, -1, -1):
        for k in range(children.shape[1]):
            child = children[node, k]
            if ~child >= len(triangles):
                for d in range(3):
                    boxes[node, d, k] = INFINITE
                    boxes[node, 3 + d, k] = -INFINITE
            elif child < 0:
                row = triangles[~child]
                for d in range(3):
                    low = row[d] + min(0.0, row[3 + d], row[6 + d])
                    high = row[d] + max(0.0, row[3 + d], row[6 + d])
                    boxes[node, d, k] = np.float32((low - centre[d]) * scale) - PAD
                    boxes[node, 3 + d, k] = np.float32((high - centre[d]) * scale) + PAD
            else:
                total += hold_children(boxes, node, k, child)
    return total / (scale * scale)


@njit(cache=True, error_model="numpy")
def hold_children(boxes, node, k, child):
    """Make the box of a node's k-th child hold that child's own boxes; returns its half area."""
    for d in range(3):
        low, high = boxes[child, d, 0], boxes[child, 3 + d, 0]
        for i in range(1, boxes.shape[2]):
            low = min(low, boxes[child, d, i])
            high = max(high, boxes[child, 3 + d, i])
        boxes[node, d, k] = low
        boxes[node, 3 + d, k] = high
    return half_area(boxes[node, :, k])
