"""The room's output: a model, and what it was learned with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from corporeal.learning.options import LearningOptions
from corporeal.model.surface_model import SurfaceModel


@dataclass(frozen=True)
class StepLog:
    """The objective after one step.

    Attributes:
        sweep: 0 for the first templates, then the sweeps; steps of one sweep share it.
        step: "poses", "templates", "joints", "correctives", "weights", "regressor", and "bone motions" and
            "first templates", which serve another objective, and "trim" and "tie", which change this one.
        registrations: how many it is measured over.
        objective: the whole, square metres.
        data: its data part.
        rms_mm: root mean square distance of a vertex.
        seconds: of the step.
    """

    sweep: int
    step: str
    registrations: int
    objective: float
    data: float
    rms_mm: float
    seconds: float


@dataclass(frozen=True, eq=False)
class LearnedModel:
    """A learned model.

    Attributes:
        model: the model.
        hands: H names, sorted: whose personal templates they are.
        subjects: H names: whose hand it is.
        templates: (H, V, 3) personal templates at the zero pose, metres.
        joints: (H, K, 3) their joints, by the model's regressor.
        names: N names of the scans that were learned from.
        poses: (N, K, 3) their axis-angle, angles in [0, pi].
        translations: (N, 3) metres.
        rms_mm: (N,) root mean square distance of every registration from the model with its personal
            template.
        log: every step.
        shape_variances: explained variance of every shape component, square metres.
        pose_variances: of every pose component of the first block, square radians.
        left_out: names of registrations that were trimmed.
        options: how it was learned.
    """

    model: SurfaceModel
    hands: tuple[str, ...]
    subjects: tuple[str, ...]
    templates: Float[np.ndarray, "H V 3"]
    joints: Float[np.ndarray, "H K 3"]
    names: tuple[str, ...]
    poses: Float[np.ndarray, "N K 3"]
    translations: Float[np.ndarray, "N 3"]
    rms_mm: Float[np.ndarray, " N"]
    log: tuple[StepLog, ...]
    shape_variances: Float[np.ndarray, " n"]
    pose_variances: Float[np.ndarray, " m"]
    left_out: tuple[str, ...]
    options: LearningOptions
