"""The 21 keypoints of a hand: joints, and points of the surface at the finger tips."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from corporeal.model.landmarks import LandmarkSet

from .rig import FINGERS

_ORDER = ("thumb", "index", "middle", "ring", "little")
_FINGER_PARTS = ("mcp", "pip", "dip", "tip")
_THUMB_PARTS = ("cmc", "mcp", "ip", "tip")


def landmark_sets(
    template: np.ndarray, faces: np.ndarray, joints: np.ndarray, tips: np.ndarray
) -> dict[str, LandmarkSet]:
    """MediaPipe's and OpenPose's 21: the order is the same, OpenPose's have numbers for names."""
    rows, columns, values, names = [0], [len(template)], [1.0], ["wrist"]
    for finger in _ORDER:
        first = 3 * FINGERS.index(finger) + 1
        for k, part in enumerate(_THUMB_PARTS if finger == "thumb" else _FINGER_PARTS):
            row = len(names)
            names.append(f"{finger}_{part}")
            if k < 3:
                rows, columns, values = rows + [row], columns + [len(template) + first + k], values + [1.0]
                continue
            axis = tips[FINGERS.index(finger)] - joints[first + 2]
            corners, barycentric = foremost_point(template, faces, joints[first + 2], axis)
            rows, columns, values = (
                rows + [row] * 3,
                columns + corners.tolist(),
                values + barycentric.tolist(),
            )
    weights = sp.csr_matrix((values, (rows, columns)), shape=(21, len(template) + len(joints)))
    openpose = tuple(f"hand_{k}" for k in range(21))
    return {
        "hand_21_mediapipe": LandmarkSet(tuple(names), weights, len(template)),
        "hand_21_openpose": LandmarkSet(openpose, weights, len(template)),
    }


def foremost_point(
    vertices: np.ndarray, faces: np.ndarray, origin: np.ndarray, direction: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Corners and barycentric weights of the last triangle that a ray leaves the surface through."""
    direction = direction / np.linalg.norm(direction)
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    ab, ac = b - a, c - a
    p = np.cross(direction, ac)
    determinant = np.einsum("fa,fa->f", ab, p)
    safe = np.where(np.abs(determinant) < 1e-15, np.inf, determinant)
    s = origin - a
    u = np.einsum("fa,fa->f", s, p) / safe
    q = np.cross(s, ab)
    v = (q @ direction) / safe
    t = np.einsum("fa,fa->f", ac, q) / safe
    near = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0) & (t < 0.04)
    face = int(np.argmax(np.where(near, t, -np.inf)))
    return faces[face], np.array([1 - u[face] - v[face], u[face], v[face]])
