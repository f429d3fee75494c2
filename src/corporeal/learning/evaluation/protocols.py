"""What is free while a model is fitted to a scan: the two protocols of section 5.1 of Romero et al. 2017."""

from __future__ import annotations

from dataclasses import dataclass

from corporeal.learning.evaluation.results import Protocol
from corporeal.model.surface_model import SurfaceModel


@dataclass(frozen=True)
class PoseOnly:
    """Paper 5.1, for the pose space: a personal template, made from other scans, and only the pose free."""

    @property
    def name(self) -> Protocol:
        """As the figures say it."""
        return "pose only"


@dataclass(frozen=True)
class PoseAndShape:
    """Paper 5.1, "effect of parameter learning": the shape free too.

    The prior of the shape is the plain norm of the coefficients, each in its model's own standard deviations.

    Attributes:
        shape_count: most shape coefficients solved for.
    """

    shape_count: int = 30

    @property
    def name(self) -> Protocol:
        """As the figures say it."""
        return "pose and shape free"


FitProtocol = PoseOnly | PoseAndShape


def free_shape_count(model: SurfaceModel, protocol: FitProtocol) -> int:
    """How many shape coefficients of a model are solved for.

    Raises:
        ValueError: pose only is asked of a model with shape directions.
    """
    if isinstance(protocol, PoseAndShape):
        return min(protocol.shape_count, model.shape_count)
    if model.shape_count:
        raise ValueError(
            f"protocol: pose only, but {model.name!r} has {model.shape_count} shape directions; give a "
            "personal model"
        )
    return 0
