"""Eyeballs for a mesh that has empty sockets: each socket is turned inside out onto a ball.

The source's surface goes in between the lids and lines a pocket; its eyes are meshes of their own, which the
wheel does not have. Laid on the front of a ball round the eye's joint, the pocket is the visible eye:
the body stays one closed surface with the source's vertices, and the eyes can turn. Two more pieces (as
SMPL-X has them) would hide a pocket behind each ball, where closest points get lost.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .rig import JOINT_NAMES, Stance
from .symmetry import MIRROR

_LEFT, _RIGHT, _HEAD = (JOINT_NAMES.index(n) for n in ("left_eye_smplhf", "right_eye_smplhf", "head"))
# How far the rings of the socket, from the lids inward, turn with the eye; the others do wholly.
_RING_SHARES = (0.35, 0.75)
# Metres; an adult's eyeball. The lids' edges are 13 to 15 mm from the joint.
RADIUS = 0.0125
_REACH = 0.022
_UNDER_LIDS = 1.12


@dataclass(frozen=True, eq=False)
class Eyes:
    """The left socket, its rim, how it lies flat in it, how far each vertex turns with the eye."""

    socket: np.ndarray
    rim: np.ndarray
    flat: np.ndarray
    shares: np.ndarray
    mirror: np.ndarray

    @classmethod
    def of_mesh(cls, stance: Stance, faces: np.ndarray, mirror: np.ndarray) -> Eyes:
        """Found on one person, valid for all."""
        socket = socket_vertices(stance.vertices, faces, stance.joints[_LEFT])
        rim = rim_of(faces, socket, len(mirror))
        reached, shares = rim, np.ones(len(socket))
        for share in _RING_SHARES:
            touched = np.unique(faces[np.isin(faces, reached).any(1)])
            shares[np.isin(socket, touched) & ~np.isin(socket, reached)] = share
            reached = np.union1d(reached, touched)
        return cls(socket, rim, laid_flat(stance.vertices, faces, socket, rim), shares, mirror)

    def opened(self, stance: Stance) -> Stance:
        """The person with eyeballs."""
        vertices = with_eyeball(stance.vertices, self.socket, self.rim, self.flat, stance.joints[_LEFT])
        vertices[self.mirror[self.socket]] = vertices[self.socket] * MIRROR
        return Stance(vertices, stance.joints, stance.tips)

    def weighted(self, weights: np.ndarray) -> np.ndarray:
        """Skinning weights (V, 55) with those of the eyeballs, which the source leaves to the head."""
        weights = weights.copy()
        for vertices, joint in ((self.socket, _LEFT), (self.mirror[self.socket], _RIGHT)):
            weights[vertices] = 0
            weights[vertices, joint] = self.shares
            weights[vertices, _HEAD] = 1 - self.shares
        return weights


def socket_vertices(vertices: np.ndarray, faces: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Vertices of the pocket round an eye's centre: the connected ones behind the lids that look inward."""
    normals = np.zeros_like(vertices)
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    for k in range(3):
        np.add.at(normals, faces[:, k], np.cross(b - a, c - a))
    offset = vertices - centre
    inside = (np.einsum("va,va->v", normals, offset) < 0) & (np.linalg.norm(offset, axis=1) < _REACH)
    start = int(np.argmin(np.where(inside, offset[:, 2], np.inf)))
    own = inside[faces].sum(1) >= 2
    found = np.zeros(len(vertices), dtype=bool)
    found[start] = True
    while True:
        grown = found.copy()
        grown[faces[own & found[faces].any(1)]] = True
        grown &= inside
        if np.array_equal(grown, found):
            return np.flatnonzero(found)
        found = grown


def rim_of(faces: np.ndarray, socket: np.ndarray, count: int) -> np.ndarray:
    """Vertices that share a triangle with the socket's and are none of them: the lids' edge."""
    own = np.zeros(count, dtype=bool)
    own[socket] = True
    touched = np.unique(faces[own[faces].any(1)])
    return touched[~own[touched]]


def laid_flat(vertices: np.ndarray, faces: np.ndarray, socket: np.ndarray, rim: np.ndarray) -> np.ndarray:
    """(socket, rim) weights that spread the socket evenly inside its rim: Tutte's embedding."""
    place = np.full(len(vertices), -1)
    place[np.concatenate([socket, rim])] = np.arange(len(socket) + len(rim))
    edges = place[np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])]
    edges = edges[(edges >= 0).all(1)]
    joined = np.zeros((len(socket) + len(rim),) * 2)
    joined[edges[:, 0], edges[:, 1]] = joined[edges[:, 1], edges[:, 0]] = 1
    rows = joined[: len(socket)]
    inner = np.diag(rows.sum(1)) - rows[:, : len(socket)]
    return np.linalg.solve(inner, rows[:, len(socket) :])


def with_eyeball(
    vertices: np.ndarray, socket: np.ndarray, rim: np.ndarray, flat: np.ndarray, centre: np.ndarray
) -> np.ndarray:
    """The surface with one socket laid on its ball, inside the lids' edge as seen from the eye's joint."""
    offset = vertices[rim] - centre
    angle = np.arccos(offset[:, 2] / np.linalg.norm(offset, axis=1))
    across = offset[:, :2] / np.linalg.norm(offset[:, :2], axis=1, keepdims=True)
    # The outermost ring goes to the lids' edge and under it.
    spread = _UNDER_LIDS * (flat @ (across * angle[:, None]))
    middle = (across * angle[:, None]).mean(0)
    spread -= (_UNDER_LIDS - 1) * middle
    angle = np.linalg.norm(spread, axis=1, keepdims=True)
    ring = np.concatenate([np.sinc(angle / np.pi) * spread, np.cos(angle)], axis=1)
    turned = vertices.copy()
    turned[socket] = centre + RADIUS * ring
    return turned
