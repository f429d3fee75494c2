"""What stage one of tracking gives: the body with a subject's template, and where the sequence starts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from corporeal.model.surface_model import SurfaceModel


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
    """

    model: SurfaceModel
    shape: Float[np.ndarray, " s"]
    used: tuple[str, ...]
    rejected: dict[str, str]
    start_pose: Float[np.ndarray, "K 3"]
    start_translation: Float[np.ndarray, "3"]


def personal_model(model: SurfaceModel, template: Float[np.ndarray, "V 3"]) -> SurfaceModel:
    """The model with a template of its own, neither shape nor expression; joints by the model's regressor."""
    return model.replace(
        template=np.asarray(template, dtype=np.float64),
        shape_directions=np.zeros((len(template), 3, 0)),
        expression_directions=np.zeros((len(template), 3, 0)),
    )
