"""Part of a model's people, for instance one sex, as a mean and directions inside the model's shape space."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from corporeal.model.surface_model import SurfaceModel


@dataclass(frozen=True, eq=False)
class Population:
    """Some of the people that a shape space was made of, told by coefficients of that space.

    Attributes:
        mean: (S,) their mean.
        directions: (S, S) columns: their own principal directions of unit variance, largest first.
    """

    mean: Float[np.ndarray, " S"]
    directions: Float[np.ndarray, "S S"]


def of_population(model: SurfaceModel, population: Population, name: str) -> SurfaceModel:
    """The model about the population's mean, with the population's own directions; it spans the same shapes.

    Raises:
        ValueError: the population is of another shape space.
    """
    if len(population.mean) != model.shape_count:
        raise ValueError(
            f"population: {len(population.mean)} coefficients for {model.shape_count} shape directions"
        )
    return model.replace(
        name=name,
        template=model.template + model.shape_directions @ population.mean,
        shape_directions=model.shape_directions @ population.directions,
    )
