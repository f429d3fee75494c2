"""Registrations of a tube whose model is known, and that model."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from corporeal.geometry.normals import vertex_normals
from corporeal.learning.rigging import bone_weights, ring_regressor
from corporeal.learning.start_model import start_model
from corporeal.learning.training_set import TrainingSet
from corporeal.model.jacobian import evaluate
from corporeal.model.statistics import PoseBlock
from corporeal.model.surface_model import SurfaceModel

SIDES, RINGS, LENGTH, RADIUS = 10, 25, 0.12, 0.012
JOINTS = np.array([[-0.015, 0, 0], [-0.05, 0, 0], [-0.085, 0, 0]]) + [0.3, 0.1, 0.0]
PARENTS = np.array([-1, 0, 1])
NAMES = ("base", "middle", "tip")
NOISE = 1e-4


@dataclass(frozen=True)
class KnownTube:
    """The model that made the registrations, and what each was made with."""

    model: SurfaceModel
    start: SurfaceModel
    training: TrainingSet
    held_out: TrainingSet
    coefficients: dict[str, np.ndarray]


def tube() -> tuple[np.ndarray, np.ndarray]:
    """A closed tube along -x: rings of vertices and a pole at either end."""
    angle = 2 * np.pi * np.arange(SIDES) / SIDES
    along = -np.linspace(0, LENGTH, RINGS)
    radius = RADIUS * (1 + 0.1 * np.sin(40 * along))[:, None]
    points = np.stack(
        [
            np.broadcast_to(along[:, None], (RINGS, SIDES)),
            radius * np.cos(angle),
            0.8 * radius * np.sin(angle),
        ],
        axis=-1,
    ).reshape(-1, 3)
    points = np.concatenate([points, [[0.004, 0, 0], [-LENGTH - 0.004, 0, 0]]]) + [0.3, 0.1, 0.0]
    faces, top, end = [], RINGS * SIDES, RINGS * SIDES + 1
    for side in range(SIDES):
        other = (side + 1) % SIDES
        faces += [[top, side, other], [end, top - SIDES + other, top - SIDES + side]]
        for ring in range(0, top - SIDES, SIDES):
            a, b, c, d = ring + side, ring + other, ring + SIDES + side, ring + SIDES + other
            faces += [[a, c, b], [b, c, d]]
    return points, np.array(faces)


def known_model(rng: np.random.Generator) -> SurfaceModel:
    """Three shape directions of unit variance, and correctives of some millimetres around every joint."""
    points, faces = tube()
    V, K = len(points), len(PARENTS)
    rough = bone_weights(points, faces, JOINTS, PARENTS, NAMES)
    regressor = ring_regressor(points, JOINTS, PARENTS, rough, NAMES)
    weights = rough**1.5 / (rough**1.5).sum(axis=1, keepdims=True)
    arms = points - JOINTS[0]
    thickness = arms * [0, 1, 1]
    bulge = thickness * np.sin(60 * arms[:, :1])
    directions = np.stack([0.05 * arms, 0.08 * thickness, 0.08 * bulge], axis=2)
    # Bulges have no mean over a ring: a mean could as well be a joint that stands elsewhere.
    near = np.exp(-np.square(np.linalg.norm(points[:, None] - JOINTS[1:], axis=2) / RADIUS))
    around = np.arctan2(thickness[:, 2], thickness[:, 1])
    waves = np.stack([np.ones(V), np.cos(2 * around), np.sin(2 * around)], axis=1)
    heights = np.einsum("vj,vw,wjf->vjf", near, waves, 0.002 * rng.standard_normal((3, K - 1, 9)))
    correctives = vertex_normals(points, faces)[:, :, None, None] * heights[:, None]
    return SurfaceModel(
        name="tube", template=points, faces=faces, shape_directions=directions, joint_regressor=regressor,
        skinning_weights=weights, parents=PARENTS, joint_names=NAMES,
        expression_directions=np.zeros((V, 3, 0)), pose_directions=correctives.reshape(V, 3, 9 * (K - 1)),
        side="right", pose_blocks=(PoseBlock.plain("pose", (1, 2)),),
    )  # fmt: skip


def registrations(
    model: SurfaceModel,
    rng: np.random.Generator,
    coefficients: dict[str, np.ndarray],
    count: int,
    noise: float,
) -> TrainingSet:
    """Bent tubes; the first of every person is straight. Start poses are a few degrees off."""
    people = [person for person in coefficients for _ in range(count)]
    poses = 0.15 * rng.standard_normal((len(people), model.joint_count, 3))
    poses[:, 1:, 2] += rng.uniform(0, 1.3, (len(people), model.joint_count - 1))
    poses[::count, 1:] *= 0.05
    translations = 0.1 * rng.standard_normal((len(people), 3))
    surfaces = [
        evaluate(model, coefficients[person], pose, translation).vertices
        for person, pose, translation in zip(people, poses, translations, strict=True)
    ]
    return TrainingSet(
        vertices=np.stack(surfaces) + noise * rng.standard_normal((len(people), model.vertex_count, 3)),
        poses=poses + 0.03 * rng.standard_normal(poses.shape),
        translations=translations + 1e-3 * rng.standard_normal(translations.shape),
        shapes=np.zeros((len(people), 1)),
        hands=tuple(f"{person}/right" for person in people),
        subjects=tuple(people),
        protocol_poses=tuple("straight" if index % count == 0 else "" for index in range(len(people))),
        names=tuple(f"scan{index:03d}" for index in range(len(people))),
    )


def made_tube(seed: int = 1, *, people: int = 8, count: int = 11, noise: float = NOISE) -> KnownTube:
    """The known model with registrations of it, and others of the same people that are held out."""
    rng = np.random.default_rng(seed)
    model = known_model(rng)
    drawn = rng.standard_normal((people, model.shape_count))
    # Exactly the model's statistics in the sample: mean 0, variance 1, no correlation.
    drawn = np.linalg.qr(drawn - drawn.mean(axis=0))[0] * np.sqrt(people - 1)
    coefficients = {f"s{person:02d}": row for person, row in enumerate(drawn)}
    start = start_model(model.template, model.faces, JOINTS, PARENTS.tolist(), NAMES, name="rough")
    return KnownTube(
        model,
        start.replace(side="right"),
        registrations(model, rng, coefficients, count, noise),
        registrations(model, rng, coefficients, 2, noise),
        coefficients,
    )


@pytest.fixture(scope="session")
def make_tube() -> Callable[..., KnownTube]:
    return made_tube


@pytest.fixture(scope="session")
def known_tube() -> KnownTube:
    return made_tube()


@pytest.fixture(scope="session")
def noise_rms_mm() -> float:
    """Root mean square length of the noise of a vertex."""
    return 1e3 * NOISE * np.sqrt(3)
