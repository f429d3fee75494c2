"""What stage one of tracking gives: the body with a subject's template, and where the sequence starts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from corporeal.model.joint_regressor import fit_regressor, with_regressor
from corporeal.model.surface_model import SurfaceModel

# Vertices that may bear a joint.
_MOST = 300


@dataclass(frozen=True, eq=False)
class SubjectTemplate:
    """A personal template and how it was made.

    Attributes:
        model: the body with the subject's template and no shape directions; joints regressed from it.
        shape: (s,) shape numbers of the first frame.
        used: names of the frames that were averaged.
        rejected: frame name -> why it was not used.
        start_pose: (K, 3) of the first frame, axis-angle in radians.
        start_translation: (3,) metres.
        joint_shifts: (K, 3) metres that the subject's joints lie from where the model's regressor has them,
            at the zero pose; None where they were not placed.
    """

    model: SurfaceModel
    shape: Float[np.ndarray, " s"]
    used: tuple[str, ...]
    rejected: dict[str, str]
    start_pose: Float[np.ndarray, "K 3"]
    start_translation: Float[np.ndarray, "3"]
    joint_shifts: Float[np.ndarray, "K 3"] | None = None


def personal_model(
    model: SurfaceModel,
    template: Float[np.ndarray, "V 3"],
    joints: Float[np.ndarray, "K 3"] | None = None,
) -> SurfaceModel:
    """The model with a template of its own, neither shape nor expression.

    Args:
        model: of everybody.
        template: of the subject, metres.
        joints: of the subject, at the template; None for those that the model's regressor gives.
    """
    if joints is not None:
        rows = fit_regressor(template[None], joints[None], model.joint_regressor, _MOST)
        model = with_regressor(model, rows)
    return model.replace(
        template=np.asarray(template, dtype=np.float64),
        shape_directions=np.zeros((len(template), 3, 0)),
        expression_directions=np.zeros((len(template), 3, 0)),
    )
