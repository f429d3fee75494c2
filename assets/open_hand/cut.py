"""The hand is cut from the body's mesh along an edge loop round the wrist: vertices stay the body's own."""

from __future__ import annotations

import heapq

import numpy as np

_BAND = 0.025
# How far a loop may wander, in metres, before that costs as much again as its length. The mesh's rows lean by
# 15 mm across the arm: at 2 mm the loop jumped between rows and left slivers at the opening.
_SLACK = 0.03


def cut_hand(
    vertices: np.ndarray, faces: np.ndarray, weights_of_hand: np.ndarray, at: float
) -> tuple[np.ndarray, np.ndarray]:
    """Body vertex of every hand vertex, and the hand's faces.

    Args:
        vertices: (V, 3) body in the hand's frame (fingers along -x, wrist at the origin).
        faces: (F, 3) of the body.
        weights_of_hand: (V,) sum of the hand's bones' weights: tells the hand from other parts near the band.
        at: x of the loop in metres, positive towards the elbow.
    """
    loop = _loop_round(vertices, faces, at)
    kept = _flooded(vertices, faces, loop, weights_of_hand)
    hand_faces = faces[kept]
    body_vertex = np.unique(hand_faces)
    renumbered = np.full(len(vertices), -1)
    renumbered[body_vertex] = np.arange(len(body_vertex))
    return body_vertex, renumbered[hand_faces]


def _loop_round(vertices: np.ndarray, faces: np.ndarray, at: float) -> list[int]:
    """Shortest closed path of edges round the arm near x = at: a path from a vertex to itself, once round."""
    arm = (np.abs(vertices[:, 0] - at) < _BAND) & (np.linalg.norm(vertices[:, 1:], axis=1) < 0.06)
    edges = np.unique(
        np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1), axis=0
    )
    edges = edges[arm[edges].all(axis=1)]
    centre = vertices[arm, 1:].mean(0)
    angle = np.arctan2(vertices[:, 2] - centre[1], vertices[:, 1] - centre[0])
    neighbours: dict[int, list[tuple[int, float, float]]] = {}
    for a, b in edges.tolist():
        middle = 0.5 * (vertices[a, 0] + vertices[b, 0]) - at
        cost = float(np.linalg.norm(vertices[a] - vertices[b]) * (1 + (middle / _SLACK) ** 2))
        turn = float((angle[b] - angle[a] + np.pi) % (2 * np.pi) - np.pi)
        neighbours.setdefault(a, []).append((b, cost, turn))
        neighbours.setdefault(b, []).append((a, cost, -turn))
    start = min(neighbours, key=lambda v: abs(vertices[v, 0] - at))
    return _once_round(start, neighbours)


def _once_round(start: int, neighbours: dict[int, list[tuple[int, float, float]]]) -> list[int]:
    queue: list[tuple[float, int, int, float, tuple[int, int] | None]] = [(0.0, start, 0, 0.0, None)]
    before: dict[tuple[int, int], tuple[int, int] | None] = {}
    while queue:
        cost, vertex, _, turned, previous = heapq.heappop(queue)
        state = (vertex, round(turned / (np.pi / 4)))
        if state in before:
            continue
        before[state] = previous
        if vertex == start and abs(turned - 2 * np.pi) < 0.1:
            path, node = [], before[state]
            while node is not None:
                path.append(node[0])
                node = before[node]
            return path
        for following, step, turn in neighbours[vertex]:
            heapq.heappush(queue, (cost + step, following, len(before), turned + turn, state))
    raise ValueError("no closed loop of edges round the wrist was found")


def _flooded(vertices: np.ndarray, faces: np.ndarray, loop: list[int], hand: np.ndarray) -> np.ndarray:
    """Faces reached from the fingers without crossing the loop."""
    barrier = {tuple(sorted(pair)) for pair in zip(loop, loop[1:] + loop[:1], strict=True)}
    by_edge: dict[tuple[int, int], list[int]] = {}
    for f, corners in enumerate(faces.tolist()):
        for k in range(3):
            by_edge.setdefault(tuple(sorted((corners[k], corners[(k + 1) % 3]))), []).append(f)
    tip = int(np.argmin(np.where(hand > 0.9, vertices[:, 0], np.inf)))
    stack = [int(f) for f in np.flatnonzero((faces == tip).any(axis=1))]
    seen = np.zeros(len(faces), dtype=bool)
    seen[stack] = True
    while stack:
        corners = faces[stack.pop()].tolist()
        for k in range(3):
            edge = tuple(sorted((corners[k], corners[(k + 1) % 3])))
            if edge in barrier:
                continue
            for neighbour in by_edge[edge]:
                if not seen[neighbour]:
                    seen[neighbour] = True
                    stack.append(neighbour)
    return seen
