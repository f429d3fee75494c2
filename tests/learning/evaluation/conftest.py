"""Scans of posed models whose pose is known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest

from corporeal.geometry.normals import vertex_normals
from corporeal.learning.evaluation.fit_start import start_on
from corporeal.learning.evaluation.protocols import FitProtocol
from corporeal.model.jacobian import evaluate
from corporeal.model.statistics import PoseBlock
from corporeal.model.surface_model import SurfaceModel
from corporeal.scans.scan import Scan, Unit
from corporeal.terms.model_fields import ModelParameters


@dataclass(frozen=True)
class KnownScan:
    """A scan, the parameters that made it, and a registration a little off, to begin from."""

    scan: Scan
    true: ModelParameters
    pose: np.ndarray
    vertices: np.ndarray

    def start(self, model: SurfaceModel, protocol: FitProtocol) -> ModelParameters:
        return start_on(model, self.pose, self.vertices, protocol)


def known_scan(model: SurfaceModel, true: ModelParameters, seed: int, noise: float) -> KnownScan:
    """The posed surface, noisy; its normals are those of the noisy mesh."""
    rng = np.random.default_rng(seed)
    points = evaluate(model, true.shape, true.pose, true.translation).vertices
    points = points + noise * rng.standard_normal(points.shape)
    faces = model.faces.astype(np.int64)
    scan = Scan(f"scan{seed}", points, faces, vertex_normals(points, faces), None, Unit("m", 1.0))
    near = replace(true, pose=true.pose + 0.05 * rng.standard_normal(true.pose.shape))
    vertices = evaluate(model, near.shape, near.pose, near.translation).vertices
    return KnownScan(scan, true, near.pose, vertices)


@pytest.fixture(scope="session")
def make_scan() -> Callable[..., KnownScan]:
    return known_scan


@pytest.fixture(scope="session")
def bent_tube(known_tube) -> SurfaceModel:
    """The known tube with a pose block of six orthogonal components that mix its joints."""
    mixed = np.linalg.qr(np.random.default_rng(4).standard_normal((6, 6)))[0]
    mean = np.array([0, 0.1, 0.5, 0, 0, 0.5])
    return known_tube.model.replace(
        pose_blocks=(PoseBlock("pose", (1, 2), mean, mixed, np.linspace(0.6, 0.1, 6)),)
    )


@pytest.fixture(scope="session")
def tube_scan(bent_tube) -> Callable[[int], KnownScan]:
    """Scans of bent tubes of other people."""

    def made(seed: int) -> KnownScan:
        rng = np.random.default_rng(seed)
        pose = np.concatenate([rng.standard_normal((1, 3)), 0.15 * rng.standard_normal((2, 3))])
        pose[1:, 2] += rng.uniform(0.3, 1.0, 2)
        true = ModelParameters(0.1 * rng.standard_normal(3), pose, rng.standard_normal(3))
        return known_scan(bent_tube, true, seed, 1e-4)

    return made


@pytest.fixture(scope="session")
def personal() -> Callable[[SurfaceModel, ModelParameters], SurfaceModel]:
    """A model with someone's true template and no shape directions."""

    def made(model: SurfaceModel, true: ModelParameters) -> SurfaceModel:
        template = model.template + model.shape_directions @ true.shape
        return model.replace(template=template, shape_directions=np.zeros((model.vertex_count, 3, 0)))

    return made
