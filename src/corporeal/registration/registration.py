"""The room's output: one template in correspondence with one scan."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from jaxtyping import Float

from corporeal.model.surface_model import Side, SurfaceModel
from corporeal.registration.measures import SurfaceDistances
from corporeal.scans.scan import Scan
from corporeal.terms.model_fields import ModelParameters

Status = Literal["ok", "doubtful", "failed"]


@dataclass(frozen=True, eq=False)
class Registration:
    """A scan, the model fitted to it, and the template's vertices moved onto it.

    Attributes:
        scan: the scan as it was used, in metres (with an unknown unit: in the estimated scale).
        model: the model of the scan's side.
        parameters: the fitted pose, shape and translation; metres, radians.
        model_vertices: (V, 3) the fitted model alone, metres.
        vertices: (V, 3) the registration: free vertices coupled to the model, metres.
        landmarks: landmark name -> (3,) the fitted landmarks of the model's first set, metres.
        distances: scan to registration; ``model_distances``: scan to the fitted model alone.
        status: "ok", "doubtful" or "failed"; ``reason`` says why in a sentence.
        signals: name -> what the verdict was measured by.
        correctives: whether pose correctives were used.
        seconds: stage name -> wall time.
        notes: sentences that say what was done about the side.
    """

    scan: Scan
    model: SurfaceModel
    parameters: ModelParameters
    model_vertices: Float[np.ndarray, "V 3"]
    vertices: Float[np.ndarray, "V 3"]
    landmarks: dict[str, np.ndarray]
    distances: SurfaceDistances
    model_distances: SurfaceDistances
    status: Status
    reason: str
    signals: dict[str, float] = field(default_factory=dict)
    correctives: bool = True
    seconds: dict[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    @property
    def side(self) -> Side | None:
        """Left, right, or None for a model without a side."""
        return self.model.side


@dataclass(frozen=True, eq=False)
class FailedRegistration:
    """A scan that could not be registered; ``reason`` says why and what to do."""

    scan: Scan | None
    reason: str
    seconds: dict[str, float] = field(default_factory=dict)
    status: Status = "failed"
