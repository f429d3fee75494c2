"""How a scan is registered: one record per stage, one default in one place."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from corporeal.registration.gaussian_pose import GaussianPose
from corporeal.registration.judgement import Bounds


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


@dataclass(frozen=True, kw_only=True)
class DistanceStage:
    """What every stage that looks at the scan's surface has.

    Attributes:
        points: scan points used.
        observations: independent observations that all points together stand for: what the priors are
            weighed against.
        sigma: standard deviation of a distance in metres.
        robust_scale: Geman-McClure scale in metres.
        minimum_cosine: normals must agree at least so much to be matched.
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
    shape_sigma: float = 1.0
    pose_prior_scale: float = 1.0
    separation_sigma: float = np.inf
    iterations: int


@dataclass(frozen=True, kw_only=True)
class SurfaceStage(DistanceStage):
    """Model to surface: pose, shape and place with robust distances.

    Attributes:
        scan_share: weight of the surface-to-scan term relative to the scan-to-surface term.
        landmark_sigma: standard deviation of a landmark in metres.
    """

    scan_share: float
    landmark_sigma: float


@dataclass(frozen=True, kw_only=True)
class FreeStage(DistanceStage):
    """Free vertices coupled to the model (equation 5).

    Attributes:
        coupling_sigma: standard deviation of an edge's difference from the model's, as a share of its length.
        position_sigma: standard deviation of a vertex's distance from the model's in metres.
    """

    coupling_sigma: float
    position_sigma: float


_WIDE = SurfaceStage(
    points=1500, observations=300.0, sigma=3e-3, robust_scale=20e-3, minimum_cosine=0.2,
    scan_share=0.3, landmark_sigma=6e-3, iterations=8,
)  # fmt: skip
_MIDDLE = SurfaceStage(
    points=3000, observations=600.0, sigma=2e-3, robust_scale=10e-3, minimum_cosine=0.3,
    scan_share=0.3, landmark_sigma=10e-3, pose_prior_scale=1.5, iterations=10,
)  # fmt: skip
_NARROW = SurfaceStage(
    points=5000, observations=1000.0, sigma=1e-3, robust_scale=5e-3, minimum_cosine=0.4,
    scan_share=0.2, landmark_sigma=30e-3, pose_prior_scale=2.0, separation_sigma=2e-3, iterations=15,
)  # fmt: skip
_FREE_WIDE = FreeStage(
    points=8000, observations=8000.0, sigma=1e-3, robust_scale=4e-3, minimum_cosine=0.4,
    coupling_sigma=0.10, position_sigma=10e-3, shape_sigma=0.3, separation_sigma=0.2e-3, iterations=5,
)  # fmt: skip
_FREE_NARROW = FreeStage(
    points=16000, observations=16000.0, sigma=0.5e-3, robust_scale=3e-3, minimum_cosine=0.5,
    coupling_sigma=0.15, position_sigma=10e-3, shape_sigma=0.3, separation_sigma=0.1e-3, iterations=6,
)  # fmt: skip


@dataclass(frozen=True)
class RegistrationOptions:
    """All stages of one registration; ``for_sessions`` gives those for thousands of scans.

    Attributes:
        shape_count: shape coefficients solved for (at most those that the model has).
        correctives: use the model's pose correctives.
        limit_sigma: standard deviation of a transgression of the anatomical limits, radians.
        pose_prior: what is known of the pose that was asked for, in place of the model's own prior; or None.
        landmarks: the landmark stage.
        trusting_landmarks: the landmark stage of the second start, with landmarks that are right or nearly.
        surface: surface stages, from wide to narrow.
        free: free-vertex stages, from wide to narrow.
        bounds: what the verdict allows.
        second_starts: how often a fit that is not good is begun again with limbs in other poses.
        hands: whether hands that hang on a body are tried in all poses that are known of them.
    """

    shape_count: int = 30
    correctives: bool = True
    limit_sigma: float = 0.05
    pose_prior: GaussianPose | None = None
    landmarks: LandmarkStage = field(default_factory=LandmarkStage)
    trusting_landmarks: LandmarkStage = field(
        default_factory=lambda: LandmarkStage(robust_scale=20.0, pose_prior_scale=2.0)
    )
    surface: tuple[SurfaceStage, ...] = (_WIDE, _MIDDLE, _NARROW)
    free: tuple[FreeStage, ...] = (_FREE_WIDE, _FREE_NARROW)
    bounds: Bounds = field(default_factory=Bounds)
    second_starts: int = 1
    hands: bool = True

    @classmethod
    def for_bodies(cls) -> RegistrationOptions:
        """A body is ten times as long as a hand, its clothes and hair are none of it, and limbs hang freely.

        Distances are in thirds of a hand's; no second start, whose limbs would be legs and a trunk. Parts are
        kept out of each other only when vertices are free: before, a thigh that is yet too thick pushes the
        hand that rests on it away, by 4 cm in one of eight. In the narrow stage the way back weighs more than
        the way there: over the first frames of eight simulated sequences the mean vertex lies 10.0 mm from
        its place then, and 10.5 mm with a tenth of that weight and half the sigma.
        """
        usual = cls()
        surface = (
            replace(usual.surface[0], points=3000, sigma=8e-3, robust_scale=60e-3, landmark_sigma=10e-3),
            replace(usual.surface[1], points=5000, sigma=4e-3, robust_scale=30e-3, landmark_sigma=20e-3),
            replace(
                usual.surface[2],
                points=10_000,
                sigma=4e-3,
                robust_scale=12e-3,
                scan_share=2.0,
                landmark_sigma=60e-3,
                separation_sigma=np.inf,
            ),
        )
        free = (
            replace(usual.free[0], points=12_000, sigma=2e-3, robust_scale=10e-3, iterations=4),
            replace(usual.free[1], points=24_000, sigma=1e-3, robust_scale=6e-3, iterations=4),
        )
        return replace(
            usual,
            landmarks=LandmarkStage(sigma=10e-3),
            trusting_landmarks=LandmarkStage(sigma=10e-3, robust_scale=20.0, pose_prior_scale=2.0),
            surface=surface,
            free=free,
            bounds=Bounds.for_bodies(),
            second_starts=0,
        )

    @classmethod
    def for_heads(cls) -> RegistrationOptions:
        """A head is twice as long as a hand, and its nose farther from the model than a finger's skin.

        Noses decide the scales: with a hand's the tip of one stayed 8 mm outside. The parts of the model,
        eyes in their sockets, stand in each other from the beginning, so that nothing parts them.
        """
        usual = cls()
        surface = (
            replace(usual.surface[0], points=3000, robust_scale=30e-3, landmark_sigma=4e-3),
            replace(usual.surface[1], points=5000, robust_scale=15e-3, landmark_sigma=6e-3),
            replace(
                usual.surface[2],
                points=10_000,
                robust_scale=12e-3,
                landmark_sigma=10e-3,
                separation_sigma=np.inf,
                iterations=20,
            ),
        )
        free = tuple(
            replace(
                stage,
                points=points,
                robust_scale=scale,
                separation_sigma=np.inf,
                position_sigma=20e-3,
                iterations=8,
            )
            for stage, points, scale in zip(usual.free, (12_000, 24_000), (10e-3, 6e-3), strict=True)
        )
        return replace(
            usual,
            shape_count=65,
            surface=surface,
            free=free,
            bounds=Bounds.for_heads(),
            second_starts=0,
            hands=False,
        )

    @classmethod
    def for_sessions(cls) -> RegistrationOptions:
        """Fewer points and steps, sharper bounds: for sessions of thousands of scans of one scanner.

        Measured on ten simulated scans: three quarters of the time of the defaults, 4 micrometres more from
        scan to mesh and 0.04 mm more from the true vertices.
        """
        usual = cls()
        surface = zip(usual.surface, (1000, 2000, 3000), (6, 6, 8), strict=True)
        free = zip(usual.free, (5000, 10_000), (3, 4), strict=True)
        return replace(
            usual,
            surface=tuple(replace(stage, points=n, iterations=steps) for stage, n, steps in surface),
            free=tuple(replace(stage, points=n, iterations=steps) for stage, n, steps in free),
            bounds=Bounds.for_sessions(),
        )
