"""Small random models that hold every field of a ``SurfaceModel``; test files load this one by its path."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from corporeal.model.landmarks import LandmarkSet
from corporeal.model.statistics import PoseBlock, PoseMixture
from corporeal.model.surface_model import CutPlane, SurfaceModel

SIDES = 8


def tube(rng: np.random.Generator, rings: int, length: float) -> tuple[np.ndarray, np.ndarray]:
    """A bumpy tube along -x that is open at both ends, with outward faces."""
    angle = 2 * np.pi * np.arange(SIDES) / SIDES
    along = np.linspace(0, -length, rings)
    radius = 0.015 + 0.003 * rng.standard_normal((rings, SIDES))
    points = np.stack(
        [np.broadcast_to(along[:, None], radius.shape), radius * np.cos(angle), radius * np.sin(angle)],
        axis=-1,
    ).reshape(-1, 3) + np.array([0.7, 0.2, 0.05])
    faces = []
    for ring in range(rings - 1):
        for side in range(SIDES):
            a, b = ring * SIDES + side, ring * SIDES + (side + 1) % SIDES
            faces += [[a, a + SIDES, b], [b, a + SIDES, b + SIDES]]
    return points, np.array(faces)


def regressor(rng: np.random.Generator, centres: np.ndarray, points: np.ndarray) -> sp.csr_matrix:
    """Each joint is a convex combination of its eight nearest vertices."""
    rows = np.zeros((len(centres), len(points)))
    for joint, centre in enumerate(centres):
        near = np.argsort(np.linalg.norm(points - centre, axis=1))[:8]
        rows[joint, near] = 1 + 0.2 * rng.random(8)
    return sp.csr_matrix(rows / rows.sum(1, keepdims=True))


def block(rng: np.random.Generator, name: str, joints: tuple[int, ...]) -> PoseBlock:
    """A pose block with every statistic."""
    size, count = 3 * len(joints), min(3, 3 * len(joints))
    factor = rng.standard_normal((2, size, size))
    limits = np.sort(rng.standard_normal((size, 2)), axis=1)
    return PoseBlock(
        name=name,
        joints=joints,
        mean=0.1 * rng.standard_normal(size),
        components=np.linalg.qr(rng.standard_normal((size, count)))[0].T,
        component_deviations=np.sort(rng.random(count))[::-1],
        mixture=PoseMixture(
            np.array([0.4, 0.6]), rng.standard_normal((2, size)), factor @ factor.transpose(0, 2, 1)
        ),
        limits=limits,
    )


def random_model(
    rng: np.random.Generator, *, rings: int = 10, dense_weights: bool = False, expressions: int = 2
) -> SurfaceModel:
    """A right "hand": a root with two chains of two joints on a bumpy tube, away from the origin."""
    points, faces = tube(rng, rings, 0.2)
    V, parents = len(points), np.array([-1, 0, 1, 0, 3])
    K = len(parents)
    centres = np.array([0.7, 0.2, 0.05]) + np.stack(
        [-np.array([0.0, 0.05, 0.10, 0.12, 0.16]), np.zeros(K), np.zeros(K)], axis=1
    )
    regress = regressor(rng, centres, points)
    distance = np.linalg.norm(points[:, None] - (regress @ points)[None], axis=-1)
    weights = np.exp(-((distance / 0.04) ** 2))
    if not dense_weights:
        weights[weights < np.sort(weights, axis=1)[:, -3:-2]] = 0
    weights /= weights.sum(1, keepdims=True)
    corners = faces[rng.integers(len(faces), size=4)]
    return SurfaceModel(
        name="right_tube",
        template=points,
        faces=faces,
        shape_directions=0.003 * rng.standard_normal((V, 3, 4)),
        joint_regressor=regress,
        skinning_weights=weights,
        parents=parents,
        joint_names=("right_wrist", "a1", "a2", "b1", "b2"),
        expression_directions=0.002 * rng.standard_normal((V, 3, expressions)),
        pose_directions=0.001 * rng.standard_normal((V, 3, 9 * (K - 1))),
        side="right",
        parts={"right_palm": np.arange(16), "tip": np.arange(V - 16, V)},
        pose_blocks=(block(rng, "right_hand", (1, 2, 3)), block(rng, "end", (4,))),
        landmarks={
            "points": LandmarkSet.from_surface(
                ("p", "q", "r", "s"), corners, rng.dirichlet(np.ones(3), size=4), V, K
            )
        },
        cut=CutPlane(0, rng.standard_normal(3), np.array([0.6, 0.8, 0.0])),
        notes={"source": "random numbers"},
    )


def random_body(rng: np.random.Generator) -> SurfaceModel:
    """A body that knows its own symmetry: a trunk and two arms; its content is not symmetric."""
    half, half_faces = tube(rng, 6, 0.3)
    n = len(half)
    half = half - half[:, 0].min() + 0.02
    points = np.concatenate([half, half * [-1, 1, 1]]) + 0.001 * rng.standard_normal((2 * n, 3))
    faces = np.concatenate([half_faces, n + half_faces[:, [0, 2, 1]]])
    parents = np.array([-1, 0, 0, 1, 2])
    centres = np.array([[0, 0.2, 0.05], [0.1, 0.2, 0.05], [-0.1, 0.2, 0.05], [0.2, 0.2, 0], [-0.2, 0.2, 0]])
    weights = rng.random((2 * n, 5)) ** 4
    names = ("left_eye", "right_eye")
    landmarks = LandmarkSet.from_surface(names, faces[[3, 50]], rng.dirichlet(np.ones(3), size=2), 2 * n, 5)
    return SurfaceModel(
        name="body",
        template=points,
        faces=faces,
        shape_directions=0.01 * rng.standard_normal((2 * n, 3, 3)),
        joint_regressor=regressor(rng, centres, points),
        skinning_weights=weights / weights.sum(1, keepdims=True),
        parents=parents,
        joint_names=("pelvis", "left_shoulder", "right_shoulder", "left_wrist", "right_wrist"),
        expression_directions=np.zeros((2 * n, 3, 0)),
        pose_directions=0.002 * rng.standard_normal((2 * n, 3, 36)),
        parts={"left_arm": np.arange(n), "right_arm": np.arange(n, 2 * n)},
        pose_blocks=(
            block(rng, "body", (1, 2)),
            block(rng, "left_hand", (3,)),
            block(rng, "right_hand", (4,)),
        ),
        landmarks={"eyes": landmarks},
        mirror_vertices=np.concatenate([np.arange(n, 2 * n), np.arange(n)]),
        mirror_joints=np.array([0, 2, 1, 4, 3]),
    )
