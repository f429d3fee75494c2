"""A model alone, without free vertices, fitted to one raw scan: paper 5.1's measure of a model."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from corporeal.learning.evaluation.protocols import FitProtocol, free_shape_count
from corporeal.model.jacobian import evaluate
from corporeal.model.surface_model import SurfaceModel
from corporeal.registration.gaussian_pose import GaussianPose
from corporeal.registration.measures import beyond_cut, scan_to_mesh
from corporeal.registration.options import RegistrationOptions, SurfaceStage
from corporeal.registration.stages import Fitter
from corporeal.registration.target import SampledPoints, Target
from corporeal.scans.scan import Scan
from corporeal.solve.dogleg import Solution
from corporeal.terms.model_fields import ModelParameters
from corporeal.terms.pose_subspace import pose_subspace

# The same weak prior for every model, so that none gains by its own: each axis-angle number about zero with
# this standard deviation, radians. Against 3,000 distances of 1 mm it turns no finger that is seen by more
# than a hundredth of a radian; it settles what a scan does not show, such as fingertips hidden in a fist.
_POSE_SIGMA = 1.0
# Scan points up to so far before the wrist plane, metres, are fitted to: the same for all fits of a scan, so
# that their objectives compare.
_ARM_MARGIN = 0.01
_FEWEST_POINTS = 100
# Measured on four scans: after one run of the last stage s2m was up to 4 % above where it settled.
_REPEATS, _GAIN = 4, 1e-4
# From wide to narrow. No landmarks, no limits of joints and no separation of fingers: they would be evidence
# or priors that the models need not share.
_STAGES = (
    SurfaceStage(
        points=1500, observations=500.0, sigma=3e-3, robust_scale=20e-3, minimum_cosine=0.2,
        scan_share=0.3, landmark_sigma=np.inf, iterations=10,
    ),
    SurfaceStage(
        points=2500, observations=1500.0, sigma=2e-3, robust_scale=10e-3, minimum_cosine=0.3,
        scan_share=0.3, landmark_sigma=np.inf, iterations=10,
    ),
    SurfaceStage(
        points=4000, observations=3000.0, sigma=1e-3, robust_scale=5e-3, minimum_cosine=0.4,
        scan_share=0.2, landmark_sigma=np.inf, iterations=25,
    ),
)  # fmt: skip

# The ways of a full fit: wide to narrow, and with later beginnings, since its start is near. A model that is
# fitted with the full pose alone must not end worse than one that comes to it through few components: on 18
# scans their means were 0.420 mm and 0.421.
_PATHS = (_STAGES, _STAGES[1:], _STAGES[2:])


@dataclass(frozen=True, eq=False)
class ModelFit:
    """A model fitted to a scan.

    Attributes:
        parameters: translation in metres, pose in radians, shape coefficients.
        components: of the pose; None where it was free.
        objective: the last stage's cost, by which fits of one model to one scan are compared.
        status: "ok", or "failed": then nothing is measured, and ``reason`` says why.
        reason: why, or "".
        s2m_mm: mean, median, p95, under_1mm and scored_share of the unrobust distances from the scan to the
            fitted surface, as in registration: beyond the model's cut plane, not within 1 mm of its open
            boundary.
    """

    parameters: ModelParameters
    components: int | None
    objective: float
    status: Literal["ok", "failed"]
    reason: str
    s2m_mm: dict[str, float]


def fit_model(
    model: SurfaceModel,
    scan: Scan,
    start: ModelParameters,
    protocol: FitProtocol,
    *,
    components: int | None = None,
    correctives: bool = True,
) -> ModelFit:
    """Fit a model to a scan with robust distances annealed from wide to narrow.

    Args:
        model: of the scan's side.
        scan: in metres.
        start: pose and place of an existing registration; see ``start_on``. An empty shape is the template's.
        protocol: what is free. For ``PoseOnly`` a model without shape directions.
        components: the pose is the mean and so many principal components of it; None leaves it free.
        correctives: False leaves the model's pose correctives out.

    Raises:
        ValueError: the model does not fit the protocol or the start, or has fewer components.
    """
    return ModelFitter(model, scan, start, protocol, correctives=correctives).fit(components)


class ModelFitter:
    """Fits of one model to one scan by number of pose components; what they share is made once."""

    def __init__(
        self,
        model: SurfaceModel,
        scan: Scan,
        start: ModelParameters,
        protocol: FitProtocol,
        *,
        correctives: bool = True,
    ) -> None:
        """See ``fit_model``."""
        self._start = _checked_start(model, start, protocol).vector()
        self._scan = scan
        self._model = model
        posed = evaluate(model, start.shape, start.pose, start.translation, correctives=correctives)
        near = beyond_cut(scan.points, model.cut, posed, _ARM_MARGIN)
        self._fitter: Fitter | None = None
        if near.sum() >= _FEWEST_POINTS:
            options = _options(model, protocol, correctives)
            self._fitter = _FixedPointsFitter(model, Target(scan.subset(near)), None, options)

    def fit(self, components: int | None = None, fewer: ModelFit | None = None) -> ModelFit:
        """Fit with so many components, or with all of the pose (None).

        Args:
            components: or None.
            fewer: a fit with fewer components, whose pose this one also holds. The last stage is run from it
                too, and the lowest of the objectives (its own among them) is kept: more components thus never
                end worse by the bad luck of their way, and the objective falls with their number by
                construction. s2m follows the objective but for its robust kernel.
        """
        if self._fitter is None:
            reason = f"fewer than {_FEWEST_POINTS} points on the hand's side of the start's wrist"
            return self._failed(components, reason)
        subspace = None
        if components is not None:
            subspace = pose_subspace(self._model, self._fitter.fields.columns, components)
        fitter = self._fitter.within(subspace)
        paths = _PATHS if components is None else _PATHS[:1]
        found = [_along(fitter, self._start, stages) for stages in paths]
        known = fewer is not None and fewer.status == "ok"
        if fewer is not None and known:
            found.append(fitter.fit_surface(fewer.parameters.vector(), _STAGES[-1]))
        usable = [solution for solution in found if solution.outcome.usable]
        if not usable:
            return self._failed(components, found[0].outcome.value)
        best = _settled(fitter, min(usable, key=lambda solution: solution.cost))
        if fewer is not None and known and fewer.objective <= best.cost:
            return dataclasses.replace(fewer, components=components)
        return self._measured(components, best)

    def fit_all(self, components: Sequence[int]) -> tuple[list[ModelFit], ModelFit]:
        """Fits by ascending number of components, each also begun from the one before, and the full pose.

        Raises:
            ValueError: numbers that do not ascend.
        """
        if list(components) != sorted(set(components)):
            raise ValueError(f"components: expected ascending numbers, got {list(components)}")
        fits: list[ModelFit] = []
        for count in components:
            fits.append(self.fit(count, fits[-1] if fits else None))
        return fits, self.fit(None, fits[-1] if fits else None)

    def _measured(self, components: int | None, solution: Solution) -> ModelFit:
        if self._fitter is None:
            raise RuntimeError("nothing was fitted")
        vector = solution.state.parameters
        posed = self._fitter.fields.evaluated(vector)
        beyond = beyond_cut(self._scan.points, self._model.cut, posed)
        distances = scan_to_mesh(self._fitter.surface, posed.vertices, self._scan.points, beyond)
        if not distances.scored.any():
            return self._failed(
                components, "no point of the scan lies on the hand's side of the fitted wrist"
            )
        parameters = self._fitter.fields.parameters(vector)
        return ModelFit(parameters, components, solution.cost, "ok", "", distances.summary_mm())

    def _failed(self, components: int | None, reason: str) -> ModelFit:
        K = self._model.joint_count
        start = ModelParameters(
            self._start[:3], self._start[3 : 3 + 3 * K].reshape(K, 3), self._start[3 + 3 * K :]
        )
        return ModelFit(start, components, float("inf"), "failed", reason, {})


class _FixedPointsFitter(Fitter):
    """Fits to all points of its target, which were chosen before, wherever the model stands."""

    def near_points(self, vector: Float[np.ndarray, " Q"]) -> SampledPoints:
        """All samples."""
        return self.target.samples


def _along(fitter: Fitter, vector: Float[np.ndarray, " Q"], stages: Sequence[SurfaceStage]) -> Solution:
    for stage in stages:
        solution = fitter.fit_surface(vector, stage)
        if not solution.outcome.usable:
            break
        vector = solution.state.parameters
    return solution


def _settled(fitter: Fitter, solution: Solution) -> Solution:
    """The last stage again until it gains nothing: its first halt may be one short step on a long way."""
    for _ in range(_REPEATS):
        again = fitter.fit_surface(solution.state.parameters, _STAGES[-1])
        if not (again.outcome.usable and again.cost < (1 - _GAIN) * solution.cost):
            break
        solution = again
    return solution


def _options(model: SurfaceModel, protocol: FitProtocol, correctives: bool) -> RegistrationOptions:
    size = 3 * (model.joint_count - 1)
    return RegistrationOptions(
        shape_count=free_shape_count(model, protocol),
        correctives=correctives,
        limit_sigma=np.inf,
        pose_prior=GaussianPose(np.zeros(size), _POSE_SIGMA**2 * np.eye(size)),
    )


def _checked_start(model: SurfaceModel, start: ModelParameters, protocol: FitProtocol) -> ModelParameters:
    """The start with as many shape coefficients as are solved for."""
    count = free_shape_count(model, protocol)
    if len(start.shape) not in (0, count) or start.pose.shape != (model.joint_count, 3):
        raise ValueError(
            f"start: shape {start.shape.shape} and pose {start.pose.shape}, expected (0,) or ({count},), and "
            f"({model.joint_count}, 3)"
        )
    return start if len(start.shape) else dataclasses.replace(start, shape=np.zeros(count))
