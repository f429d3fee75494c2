"""Numba kernels of the rasteriser: homogeneous edge functions (Olano and Greer 1997), one thread per row set.

``lens`` is focal x, focal y, centre x, centre y in pixels; points are in the camera's frame.
"""

import numpy as np
from numba import njit, prange


@njit(cache=True)
def _grown(box, x, y):
    return min(box[0], x), max(box[1], x), min(box[2], y), max(box[3], y)


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
        # A tuple: an array here would be allocated for every face, which was half of this kernel's time.
        box = (np.inf, -np.inf, np.inf, -np.inf)
        for k in range(3):
            p, q = vertices[faces[f, k]], vertices[faces[f, (k + 1) % 3]]
            if p[2] >= near:
                box = _grown(box, p[0] / p[2], p[1] / p[2])
            if (p[2] >= near) != (q[2] >= near):
                t = (near - p[2]) / (q[2] - p[2])
                x, y = p[0] + t * (q[0] - p[0]), p[1] + t * (q[1] - p[1])
                box = _grown(box, x / near, y / near)
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
def headlight(face, normals, lens, tint, picture):
    """Lambert shading of flat faces, lit from the camera, over what ``picture`` holds where nothing is seen.

    ``normals`` are the faces' in the camera's frame, of any length; colours are 0..255.
    """
    for y in prange(face.shape[0]):
        ry = (y + 0.5 - lens[3]) / lens[1]
        for x in range(face.shape[1]):
            f = face[y, x]
            if f < 0:
                continue
            rx = (x + 0.5 - lens[2]) / lens[0]
            nx, ny, nz = normals[f, 0], normals[f, 1], normals[f, 2]
            squared = (nx * nx + ny * ny + nz * nz) * (rx * rx + ry * ry + 1.0)
            cosine = abs(nx * rx + ny * ry + nz) / np.sqrt(squared) if squared > 0.0 else 0.0
            brightness = 0.25 + 0.75 * min(cosine, 1.0)
            for k in range(3):
                picture[y, x, k] = np.uint8(min(brightness * tint[k], 255.0) + 0.5)


@njit(cache=True)
def _ball_range(across, away, radius, focal, centre, count):
    """Pixels along one axis that a ball can cover; it lies in a box whose corners project to the extremes."""
    nearest, farthest = away - radius, away + radius
    low = min((across - radius) / nearest, (across - radius) / farthest)
    high = max((across + radius) / nearest, (across + radius) / farthest)
    return _pixel_range(low * focal + centre, high * focal + centre, count)


@njit(cache=True)
def _disc_hit(point, normal, radius, rx, ry):
    """Depth at which the ray (rx, ry, 1) meets the disc and the squared distance to its middle; -1: a miss.

    A normal of zero length means a disc that faces the camera.
    """
    px, py, pz = point[0], point[1], point[2]
    nx, ny, nz = normal[0], normal[1], normal[2]
    if nx * nx + ny * ny + nz * nz == 0.0:
        nx, ny, nz = px, py, pz
    slope = nx * rx + ny * ry + nz
    if slope == 0.0:
        return -1.0, 0.0
    z = (nx * px + ny * py + nz * pz) / slope
    dx, dy, dz = z * rx - px, z * ry - py, z - pz
    squared = dx * dx + dy * dy + dz * dz
    if not squared <= radius * radius:
        return -1.0, 0.0
    return z, squared


@njit(cache=True, parallel=True)
def fill_discs(points, normals, radii, lens, near, depth, index, threads):
    """Z-buffer of flat discs; thread t owns the rows t, t + threads, ..."""
    height, width = depth.shape
    for t in prange(threads):
        for i in range(points.shape[0]):
            if not points[i, 2] - radii[i] > near:
                continue
            x0, x1 = _ball_range(points[i, 0], points[i, 2], radii[i], lens[0], lens[2], width)
            y0, y1 = _ball_range(points[i, 1], points[i, 2], radii[i], lens[1], lens[3], height)
            for y in range(y0 + (t - y0) % threads, y1, threads):
                ry = (y + 0.5 - lens[3]) / lens[1]
                for x in range(x0, x1):
                    rx = (x + 0.5 - lens[2]) / lens[0]
                    z, _ = _disc_hit(points[i], normals[i], radii[i], rx, ry)
                    if z >= near and z < depth[y, x]:
                        depth[y, x] = z
                        index[y, x] = i


@njit(cache=True, parallel=True)
def blend_normals(points, normals, radii, lens, near, depth, blended, threads):
    """Sums the normals of all discs within a radius behind the visible one, weighted by 1 - d^2 / r^2."""
    height, width = depth.shape
    for t in prange(threads):
        for i in range(points.shape[0]):
            if not points[i, 2] - radii[i] > near:
                continue
            x0, x1 = _ball_range(points[i, 0], points[i, 2], radii[i], lens[0], lens[2], width)
            y0, y1 = _ball_range(points[i, 1], points[i, 2], radii[i], lens[1], lens[3], height)
            for y in range(y0 + (t - y0) % threads, y1, threads):
                ry = (y + 0.5 - lens[3]) / lens[1]
                for x in range(x0, x1):
                    rx = (x + 0.5 - lens[2]) / lens[0]
                    z, squared = _disc_hit(points[i], normals[i], radii[i], rx, ry)
                    # The smallest weight keeps a disc's own rim from having no normal at all.
                    weight = max(1.0 - squared / (radii[i] * radii[i]), 1e-3)
                    if z >= near and z <= depth[y, x] + radii[i]:
                        # Towards the camera: guessed normals of either sign must not cancel each other.
                        facing = normals[i, 0] * rx + normals[i, 1] * ry + normals[i, 2]
                        if facing > 0.0:
                            weight = -weight
                        for k in range(3):
                            blended[y, x, k] += weight * normals[i, k]
