"""Numba kernels of the rasteriser: homogeneous edge functions (Olano and Greer 1997), one thread per row set.

``lens`` is focal x, focal y, centre x, centre y in pixels; points are in the camera's frame.
"""

import numpy as np
from numba import njit, prange


@njit(cache=True)
def _grow_box(box, x, y):
    box[0] = min(box[0], x)
    box[1] = max(box[1], x)
    box[2] = min(box[2], y)
    box[3] = max(box[3], y)


@njit(cache=True)
def _pixel_range(low, high, count):
    """First and one past the last pixel whose centre can lie in [low, high], one pixel of slack included."""
    first = min(max(np.floor(low - 0.5), 0.0), float(count))
    last = min(max(np.ceil(high + 0.5), 0.0), float(count))
    return int(first), int(last)


@njit(cache=True, parallel=True)
def triangle_setup(vertices, faces, lens, size, near):
    """Edge functions and pixel boxes; a face that no pixel can see gets an empty box.

    A ray d meets the plane of corners a, b, c with weights in the ratio d.(b x c) : d.(c x a) : d.(a x b).
    They are perspective-correct, valid with corners behind the camera, and of exactly opposite sign on the
    two sides of a shared edge, so that no ray slips between neighbours.
    """
    count = faces.shape[0]
    edges = np.empty((count, 10))
    boxes = np.zeros((count, 4), np.int32)
    for f in prange(count):
        a, b, c = vertices[faces[f, 0]], vertices[faces[f, 1]], vertices[faces[f, 2]]
        for k in range(3):
            i, j = (k + 1) % 3, (k + 2) % 3
            edges[f, k] = b[i] * c[j] - b[j] * c[i]
            edges[f, 3 + k] = c[i] * a[j] - c[j] * a[i]
            edges[f, 6 + k] = a[i] * b[j] - a[j] * b[i]
        volume = a[0] * edges[f, 0] + a[1] * edges[f, 1] + a[2] * edges[f, 2]
        edges[f, 9] = volume
        if volume == 0.0 or not np.isfinite(volume):
            continue
        box = np.array([np.inf, -np.inf, np.inf, -np.inf])
        for k in range(3):
            p, q = vertices[faces[f, k]], vertices[faces[f, (k + 1) % 3]]
            if p[2] >= near:
                _grow_box(box, p[0] / p[2], p[1] / p[2])
            if (p[2] >= near) != (q[2] >= near):
                t = (near - p[2]) / (q[2] - p[2])
                _grow_box(box, (p[0] + t * (q[0] - p[0])) / near, (p[1] + t * (q[1] - p[1])) / near)
        if box[0] > box[1]:
            continue
        first, last = _pixel_range(box[0] * lens[0] + lens[2], box[1] * lens[0] + lens[2], size[0])
        boxes[f, 0], boxes[f, 1] = first, last
        first, last = _pixel_range(box[2] * lens[1] + lens[3], box[3] * lens[1] + lens[3], size[1])
        boxes[f, 2], boxes[f, 3] = first, last
    return edges, boxes


@njit(cache=True, parallel=True)
def fill_triangles(edges, boxes, lens, near, depth, face, threads):
    """Z-buffer; thread t owns the rows t, t + threads, ... so that no two threads write one pixel."""
    width = depth.shape[1]
    ray_x = np.empty(width)
    for x in range(width):
        ray_x[x] = (x + 0.5 - lens[2]) / lens[0]
    for t in prange(threads):
        for f in range(boxes.shape[0]):
            x0, x1, y0, y1 = boxes[f, 0], boxes[f, 1], boxes[f, 2], boxes[f, 3]
            if x0 >= x1:
                continue
            # Dividing by the volume would let one winding through; its sign keeps both.
            sign = 1.0 if edges[f, 9] > 0.0 else -1.0
            volume = sign * edges[f, 9]
            ax, ay, az = sign * edges[f, 0], sign * edges[f, 1], sign * edges[f, 2]
            bx, by, bz = sign * edges[f, 3], sign * edges[f, 4], sign * edges[f, 5]
            cx, cy, cz = sign * edges[f, 6], sign * edges[f, 7], sign * edges[f, 8]
            for y in range(y0 + (t - y0) % threads, y1, threads):
                ry = (y + 0.5 - lens[3]) / lens[1]
                for x in range(x0, x1):
                    a = ax * ray_x[x] + ay * ry + az
                    b = bx * ray_x[x] + by * ry + bz
                    c = cx * ray_x[x] + cy * ry + cz
                    total = a + b + c
                    if a < 0.0 or b < 0.0 or c < 0.0 or total <= 0.0:
                        continue
                    z = volume / total
                    # Faces come in order and only a smaller depth wins: ties go to the lower index.
                    if z >= near and z < depth[y, x]:
                        depth[y, x] = z
                        face[y, x] = f


@njit(cache=True, parallel=True)
def barycentric_weights(edges, face, lens, weights):
    """Perspective-correct weights of the visible face's corners."""
    for y in prange(face.shape[0]):
        ry = (y + 0.5 - lens[3]) / lens[1]
        for x in range(face.shape[1]):
            f = face[y, x]
            if f < 0:
                continue
            rx = (x + 0.5 - lens[2]) / lens[0]
            total = 0.0
            for k in range(3):
                value = edges[f, 3 * k] * rx + edges[f, 3 * k + 1] * ry + edges[f, 3 * k + 2]
                weights[y, x, k] = value
                total += value
            for k in range(3):
                weights[y, x, k] /= total


@njit(cache=True, parallel=True)
def fill_discs(points, normals, radius, lens, near, depth, index, threads):
    """Z-buffer of flat discs; normals of zero length mean a disc that faces the camera."""
    height, width = depth.shape
    for t in prange(threads):
        for i in range(points.shape[0]):
            px, py, pz = points[i, 0], points[i, 1], points[i, 2]
            if not pz - radius > near:
                continue
            nx, ny, nz = normals[i, 0], normals[i, 1], normals[i, 2]
            if nx * nx + ny * ny + nz * nz == 0.0:
                nx, ny, nz = px, py, pz
            # The disc lies in a ball; the ball in a box at its nearest depth.
            near_z = pz - radius
            low, high = (
                min((px - radius) / near_z, (px - radius) / pz),
                max((px + radius) / near_z, (px + radius) / pz),
            )
            x0, x1 = _pixel_range(low * lens[0] + lens[2], high * lens[0] + lens[2], width)
            low, high = (
                min((py - radius) / near_z, (py - radius) / pz),
                max((py + radius) / near_z, (py + radius) / pz),
            )
            y0, y1 = _pixel_range(low * lens[1] + lens[3], high * lens[1] + lens[3], height)
            plane = nx * px + ny * py + nz * pz
            for y in range(y0 + (t - y0) % threads, y1, threads):
                ry = (y + 0.5 - lens[3]) / lens[1]
                for x in range(x0, x1):
                    rx = (x + 0.5 - lens[2]) / lens[0]
                    slope = nx * rx + ny * ry + nz
                    if slope == 0.0:
                        continue
                    z = plane / slope
                    if not (z >= near and z < depth[y, x]):
                        continue
                    dx, dy, dz = z * rx - px, z * ry - py, z - pz
                    if dx * dx + dy * dy + dz * dz <= radius * radius:
                        depth[y, x] = z
                        index[y, x] = i
