"""The objective of learning: squared distances of vertices, and what holds the variables back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from corporeal.learning.hinges import HingePrior
from corporeal.learning.options import LearningOptions
from corporeal.learning.state import LearningState, Registrations

_CENTIMETRE = 0.01


@dataclass(frozen=True, eq=False)
class Priors:
    """What the variables are held to.

    Attributes:
        templates: (H, V, 3) the start model's shape of every hand.
        weights: (V, K) the start model's skinning weights.
        joint_strengths: (H, K, 3, 3) observations that hold a joint to its regressed place, by direction.
        distances: (K - 1, V) metres from every joint to every vertex: the cost of a corrective (equation 10).
        hinges: of joints that turn about one axis alone; None where there are none.
    """

    templates: Float[np.ndarray, "H V 3"]
    weights: Float[np.ndarray, "V K"]
    joint_strengths: Float[np.ndarray, "H K 3 3"]
    distances: Float[np.ndarray, "J V"]
    hinges: HingePrior | None = None


@dataclass(frozen=True)
class Objective:
    """Parts of the objective in square metres; ``total`` is what every step lowers.

    Attributes:
        data: weighted sum of squared distances of vertices.
        templates: of personal templates from the start model's shape.
        joints: of joints from their regressed places.
        correctives: equation 10.
        weights: of skinning weights from the start model's.
        hinges: of their turns across the axis.
        rms_mm: root mean square distance of a vertex over all registrations, unweighted.
    """

    data: float
    templates: float
    joints: float
    correctives: float
    weights: float
    hinges: float
    rms_mm: float

    @property
    def total(self) -> float:
        """The sum."""
        return self.data + self.templates + self.joints + self.correctives + self.weights + self.hinges


def corrective_costs(priors: Priors, options: LearningOptions) -> Float[np.ndarray, "J V"]:
    """Cost of a squared corrective per joint and vertex: equation 10 squared, or SMPL's constant.

    In units of ``corrective_strength`` at one centimetre.
    """
    if options.regularisation == "constant":
        distances = np.full_like(priors.distances, options.constant_distance)
    else:
        distances = priors.distances
    return options.corrective_strength * (distances / _CENTIMETRE) ** 2


def weight_cost(options: LearningOptions) -> float:
    """Cost of a squared difference of a skinning weight, square metres."""
    return options.weight_strength * _CENTIMETRE**2


def objective(
    state: LearningState, data: Registrations, priors: Priors, options: LearningOptions
) -> Objective:
    """Measure the state."""
    errors = state.squared_errors(data)
    shifts = state.joints - np.stack([state.regressor @ template for template in state.templates])
    correctives = 0.0
    if state.has_correctives:
        J, V = priors.distances.shape
        squares = np.square(state.pose_directions).reshape(J, 9, V, 3).sum(axis=(1, 3))
        correctives = float((corrective_costs(priors, options) * squares).sum())
    return Objective(
        data=float(data.importance @ errors),
        templates=options.template_strength * float(np.square(state.templates - priors.templates).sum()),
        joints=float(np.einsum("hka,hkab,hkb->", shifts, priors.joint_strengths, shifts)),
        correctives=correctives,
        weights=weight_cost(options) * float(np.square(state.weights - priors.weights).sum()),
        hinges=0.0 if priors.hinges is None else float(priors.hinges.costs(state.rotations).sum()),
        rms_mm=1e3 * float(np.sqrt(errors.sum() / (errors.size * state.templates.shape[1]))),
    )
