"""What stands beside the hand: the stand of the forearm, and green objects in grasps."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from corporeal.scans.simulation.sampling_pattern import SamplingPattern
from corporeal.scans.simulation.scanner import SampledSurface

# Warm enough that noise never makes it count as a green object.
_GREY = np.array([140.0, 120.0, 112.0])
_GREEN = np.array([70.0, 190.0, 60.0])
_SPACING = 1.3e-3
_HAND = 1
_LARGEST = 0.03  # metres, radius of held objects
_DEEPEST = 1.5e-3  # metres that skin may reach into them
_OFFSETS = np.arange(0.012, 0.06, 0.001)


def hand_stand(elbow: Float[np.ndarray, "3"], wrist: Float[np.ndarray, "3"]) -> SampledSurface:
    """A grey block that the lower forearm leans against.

    Args:
        elbow: the forearm's axis begins here, metres, in the scanner's frame (fingers up, +z).
        wrist: and ends here.
    """
    along = wrist - elbow
    along /= np.linalg.norm(along)
    side = np.cross(along, [0.0, 1.0, 0.0])
    side /= np.linalg.norm(side)
    # It stands beside the last 4 cm of the arm that is scanned, and touches it or nearly.
    centre = wrist - 0.105 * along + 0.045 * side
    turn = np.column_stack([side, np.cross(along, side), along])
    return _box(centre, turn, np.array([0.012, 0.03, 0.025]), _GREY)


def held_object(
    posed: Float[np.ndarray, "V 3"], joints: Float[np.ndarray, "17 3"], generator: np.random.Generator
) -> SampledSurface | None:
    """A green bar, ball or box where a bent hand would hold it, or None where there is no room for one.

    Args:
        posed: the hand's skin, metres.
        joints: heads of its bones.
        generator: picks the shape.
    """
    across = joints[2] - joints[8]
    across /= np.linalg.norm(across)
    centre, room = _hollow(posed, joints, across)
    if room < 6e-3:
        return None
    kind = generator.integers(3)
    turn = np.column_stack([across, *_others(across)])
    if kind == 0:
        return _ball(centre, 1.02 * room, _GREEN)
    # Along the knuckles a bar may be longer than the room is wide.
    half = np.array([0.06, 0.7 * room, 0.7 * room]) if kind == 1 else np.full(3, 0.62 * room)
    local = np.abs((posed - centre) @ turn)
    while (half - local).min(axis=1).max() > _DEEPEST:
        half[1:] *= 0.85
    return _box(centre, turn, half, _GREEN) if half[1] > 3e-3 else None


def _hollow(posed: np.ndarray, joints: np.ndarray, across: np.ndarray) -> tuple[np.ndarray, float]:
    """Centre and radius of a ball that lies on the palm, as large as the fingers leave room for.

    The mean of knuckles, tips and wrist was refused: it lies in the flesh of most grasps.
    """
    knuckles, tips = joints[[2, 5, 8, 11]].mean(0), joints[[4, 7, 10, 13]].mean(0)
    palm = np.cross(across, knuckles - joints[_HAND])
    palm *= np.sign(palm @ (tips - knuckles)) / np.linalg.norm(palm)
    line = 0.75 * knuckles + 0.25 * joints[_HAND] + _OFFSETS[:, None] * palm
    rooms = cKDTree(posed).query(line)[0]
    # The first place that is wide enough: a small object in a wide hand lies on the palm.
    best = int(np.argmax(rooms >= min(rooms.max(), _LARGEST)))
    return line[best], float(min(rooms[best], _LARGEST))


def _others(direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    first = np.cross(direction, [0.0, 0.0, 1.0])
    first /= np.linalg.norm(first)
    return first, np.cross(direction, first)


def _box(centre: np.ndarray, turn: np.ndarray, half: np.ndarray, colour: np.ndarray) -> SampledSurface:
    """A closed box of faces as fine as the scanner's points."""
    vertices, faces, offset = [], [], 0
    for axis in range(3):
        a, b = (axis + 1) % 3, (axis + 2) % 3
        counts = [max(2, int(np.ceil(2 * half[k] / _SPACING)) + 1) for k in (a, b)]
        u, v = np.meshgrid(
            *(np.linspace(-half[k], half[k], n) for k, n in zip((a, b), counts, strict=True)), indexing="ij"
        )
        for sign in (1, -1):
            points = np.zeros((u.size, 3))
            points[:, a], points[:, b], points[:, axis] = u.ravel(), v.ravel(), sign * half[axis]
            faces.append(offset + _grid_faces(counts, flipped=sign < 0))
            vertices.append(points)
            offset += len(points)
    return _vertex_sampled(centre + np.concatenate(vertices) @ turn.T, np.concatenate(faces), colour)


def _ball(centre: np.ndarray, radius: float, colour: np.ndarray) -> SampledSurface:
    rows = max(8, int(np.pi * radius / _SPACING))
    polar, around = np.meshgrid(
        np.linspace(0, np.pi, rows), np.linspace(0, 2 * np.pi, 2 * rows), indexing="ij"
    )
    points = np.stack(
        [np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)], axis=-1
    )
    turn = Rotation.from_rotvec([0.7, 0.2, 0.1]).as_matrix()
    faces = _grid_faces([rows, 2 * rows], flipped=False)
    return _vertex_sampled(centre + radius * points.reshape(-1, 3) @ turn.T, faces, colour)


def _grid_faces(counts: list[int], *, flipped: bool) -> np.ndarray:
    index = np.arange(counts[0] * counts[1]).reshape(counts)
    a, b, c, d = (
        index[:-1, :-1].ravel(),
        index[1:, :-1].ravel(),
        index[1:, 1:].ravel(),
        index[:-1, 1:].ravel(),
    )
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return faces[:, ::-1] if flipped else faces


def _vertex_sampled(vertices: np.ndarray, faces: np.ndarray, colour: np.ndarray) -> SampledSurface:
    """Points fall on the vertices themselves: a prop's place is no secret."""
    first_face = np.zeros(len(vertices), dtype=np.int64)
    corner = np.zeros(len(vertices), dtype=np.int64)
    for k in range(3):
        first_face[faces[:, k]], corner[faces[:, k]] = np.arange(len(faces)), k
    pattern = SamplingPattern(first_face, np.eye(3)[corner], faces)
    return SampledSurface(vertices, faces, np.tile(colour, (len(vertices), 1)), pattern)
