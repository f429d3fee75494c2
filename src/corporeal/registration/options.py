"""How a scan is registered: one record per stage, one default in one place."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True)
class LandmarkStage:
    """Landmarks -> pose, shape, place.

    Attributes:
        sigma: standard deviation of a landmark in metres (a detector's, triangulated, is 3-6 mm off).
        robust_scale: Geman-McClure scale in units of sigma.
        shape_sigma: standard deviation of a shape coefficient; below 1 where many correlated distances would
            outvote the prior.
        pose_prior_scale: standard deviations of the pose prior are multiplied by it.
        iterations: most solver steps.
    """

    sigma: float = 5e-3
    robust_scale: float = 3.0
    shape_sigma: float = 1.0
    pose_prior_scale: float = 1.0
    iterations: int = 25


@dataclass(frozen=True)
class SurfaceStage:
    """Model to surface: pose, shape and place with robust distances.

    Attributes:
        points: scan points used.
        observations: independent observations that all points together stand for: what the priors are
            weighed against.
        sigma: standard deviation of a distance in metres.
        robust_scale: Geman-McClure scale in metres.
        minimum_cosine: normals must agree at least so much to be matched.
        scan_share: weight of the surface-to-scan term relative to the scan-to-surface term.
        landmark_sigma: standard deviation of a landmark in metres.
        shape_sigma: standard deviation of a shape coefficient; below 1 where many correlated distances would
            outvote the prior.
        pose_prior_scale: standard deviations of the pose prior are multiplied by it.
        separation_sigma: standard deviation of the depth of one finger in another in metres; infinite leaves
            the term out.
        iterations: most solver steps.
    """

    points: int
    observations: float
    sigma: float
    robust_scale: float
    minimum_cosine: float
    scan_share: float
    landmark_sigma: float
    shape_sigma: float
    pose_prior_scale: float
    separation_sigma: float
    iterations: int


@dataclass(frozen=True)
class FreeStage:
    """Free vertices coupled to the model (equation 5).

    Attributes:
        points: scan points used.
        observations: independent observations that all points together stand for.
        sigma: standard deviation of a distance in metres.
        robust_scale: Geman-McClure scale in metres.
        minimum_cosine: normals must agree at least so much to be matched.
        coupling_sigma: standard deviation of an edge's difference from the model's, as a share of its length.
        position_sigma: standard deviation of a vertex's distance from the model's in metres.
        shape_sigma: standard deviation of a shape coefficient; below 1 where many correlated distances would
            outvote the prior.
        pose_prior_scale: standard deviations of the pose prior are multiplied by it.
        separation_sigma: standard deviation of the depth of one finger in another in metres; infinite leaves
            the term out.
        iterations: most solver steps.
    """

    points: int
    observations: float
    sigma: float
    robust_scale: float
    minimum_cosine: float
    coupling_sigma: float
    position_sigma: float
    shape_sigma: float
    pose_prior_scale: float
    separation_sigma: float
    iterations: int


@dataclass(frozen=True)
class RegistrationOptions:
    """All stages of one registration.

    Attributes:
        shape_count: shape coefficients solved for (at most those that the model has).
        correctives: use the model's pose correctives.
        limit_sigma: standard deviation of a transgression of the anatomical limits, radians.
        landmarks: the landmark stage.
        surface: surface stages, from wide to narrow.
        free: free-vertex stages, from wide to narrow.
    """

    shape_count: int = 30
    correctives: bool = True
    limit_sigma: float = 0.05
    landmarks: LandmarkStage = field(default_factory=LandmarkStage)
    surface: tuple[SurfaceStage, ...] = (
        SurfaceStage(1500, 300.0, 3e-3, 20e-3, 0.2, 0.3, 6e-3, 1.0, 1.0, np.inf, 8),
        SurfaceStage(3000, 600.0, 2e-3, 10e-3, 0.3, 0.3, 10e-3, 1.0, 1.5, np.inf, 10),
        SurfaceStage(5000, 1000.0, 1e-3, 5e-3, 0.4, 0.2, 30e-3, 1.0, 2.0, 2e-3, 15),
    )
    free: tuple[FreeStage, ...] = (
        FreeStage(8000, 8000.0, 1e-3, 4e-3, 0.4, 0.10, 10e-3, 0.3, 1.0, 0.2e-3, 5),
        FreeStage(16000, 16000.0, 0.5e-3, 3e-3, 0.5, 0.15, 10e-3, 0.3, 1.0, 0.1e-3, 6),
    )
