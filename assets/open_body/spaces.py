"""Shape space of the people, what each sex has of it, and the expression space of the face units."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# Share of its range that a face unit moves by, and how much both sides of the face move together.
_ACTIVATION, _TOGETHER = 0.32, 0.7


@dataclass(frozen=True, eq=False)
class Sex:
    """One sex in the shape space: mean (S,), and its own directions of unit variance in it (S, S)."""

    mean: np.ndarray
    directions: np.ndarray


def shape_space(people: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean (V, 3), directions (V, 3, count) of unit variance, and all shares of variance, largest first."""
    flat = people.reshape(len(people), -1)
    mean = flat.mean(0)
    centred = flat - mean
    values, vectors = np.linalg.eigh(centred @ centred.T / (len(flat) - 1))
    values, vectors = values[::-1], vectors[:, ::-1]
    directions = centred.T @ vectors[:, :count] / np.sqrt(len(flat) - 1)
    directions *= np.sign(directions[np.abs(directions).argmax(0), np.arange(count)])
    return mean.reshape(-1, 3), directions.reshape(-1, 3, count), values / values.sum()


def sex_of(people: np.ndarray, template: np.ndarray, directions: np.ndarray) -> Sex:
    """Mean and directions of some of the people, by their coefficients in the common space."""
    basis = directions.reshape(-1, directions.shape[2])
    flat = (people - template).reshape(len(people), -1)
    coefficients = np.linalg.solve(basis.T @ basis, basis.T @ flat.T).T
    mean = coefficients.mean(0)
    # Principal in millimetres of the surface, not in coefficients.
    metric = np.linalg.cholesky(basis.T @ basis)
    own = (coefficients - mean) @ metric
    values, vectors = np.linalg.eigh(own.T @ own / (len(own) - 1))
    scaled = vectors[:, ::-1] * np.sqrt(np.maximum(values[::-1], 0))
    found = np.linalg.solve(metric.T, scaled)
    return Sex(mean, found * np.sign(found[np.abs(found).argmax(0), np.arange(len(mean))]))


def expression_space(units: np.ndarray, names: tuple[str, ...], count: int) -> tuple[np.ndarray, np.ndarray]:
    """Directions (V, 3, count) through the neutral face, and all shares of variance, largest first.

    The principal directions of faces whose units move at random, left and right mostly together.
    """
    partners = np.eye(len(names))
    for i, name in enumerate(names):
        for one, two in (("Left", "Right"), ("Right", "Left")):
            if name.endswith(one) and name.removesuffix(one) + two in names:
                partners[i, names.index(name.removesuffix(one) + two)] = _TOGETHER
    root = np.linalg.cholesky(_ACTIVATION**2 * partners)
    flat = root.T @ units.reshape(len(units), -1)
    values, vectors = np.linalg.eigh(flat @ flat.T)
    values, vectors = values[::-1], vectors[:, ::-1]
    directions = flat.T @ vectors[:, :count]
    directions *= np.sign(directions[np.abs(directions).argmax(0), np.arange(count)])
    return directions.reshape(-1, 3, count), values / values.sum()
