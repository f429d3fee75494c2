"""Generalisation of the shape space (figure 14 of Romero et al. 2017): one subject left out at a time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from corporeal.learning.evaluation.results import HandResult, ShapeCurve, Summary, spread
from corporeal.learning.shape_space import principal_components

_MM = 1e3


def shape_generalisation(
    label: str,
    templates: Float[np.ndarray, "H V 3"],
    hands: Sequence[str],
    subjects: Sequence[str],
    components: Sequence[int],
) -> ShapeCurve:
    """Error of left-out personal templates, projected onto the shape space of the other subjects' templates.

    Both hands of a subject are left out together: one is nearly the mirror image of the other. The error is
    the mean distance of a vertex from its projection, without a prior. Projections are least squares onto
    nested spaces: the root mean square error of every template cannot rise with the number of components. The
    mean distance follows it closely, though nothing forces it to.

    Args:
        label: of the curve.
        templates: learned personal templates of H hands, of one side, at the zero pose, metres.
        hands: H names.
        subjects: H names.
        components: ascending numbers of components; 0 is the mean of the others alone.

    Raises:
        ValueError: fewer than three subjects, names that do not match, or more components than the templates
            of the other subjects have.
    """
    people = sorted(set(subjects))
    largest = max((sum(other == person for other in subjects) for person in people), default=0)
    most = len(templates) - largest - 1
    if len(people) < 3 or not len(hands) == len(subjects) == len(templates):
        raise ValueError(
            f"templates: {len(templates)} of {len(people)} subjects, {len(hands)} hands; expected one name "
            "and subject per template, and three subjects at least"
        )
    if list(components) != sorted(set(components)) or not components or components[0] < 0:
        raise ValueError(f"components: expected ascending numbers from 0, got {list(components)}")
    if components[-1] > most:
        raise ValueError(f"components: {components[-1]} asked for, the templates allow {most}")
    rows = templates.reshape(len(templates), -1).astype(np.float64)
    errors = np.zeros((len(rows), len(components)))
    for person in people:
        own = np.array([subject == person for subject in subjects])
        errors[own] = _projection_errors(rows[~own], rows[own], components)
    by_hand = [
        HandResult(hand, subject, tuple(float(error) for error in row))
        for hand, subject, row in zip(hands, subjects, _MM * errors, strict=True)
    ]
    return ShapeCurve(
        label=label,
        protocol="leave one subject out",
        components=tuple(components),
        mean=tuple(Summary.of(column).mean for column in _MM * errors.T),
        sd=tuple(spread(column) for column in _MM * errors.T),
        n_subjects=len(people),
        n_hands=len(rows),
        hands=tuple(by_hand),
    )


def _projection_errors(
    others: Float[np.ndarray, "m D"], own: Float[np.ndarray, "h D"], components: Sequence[int]
) -> Float[np.ndarray, "h n"]:
    """Mean vertex distance, metres, by number of components."""
    space = principal_components(others)
    coefficients = (own - space.mean) @ space.directions.T
    errors = np.zeros((len(own), len(components)))
    for column, count in enumerate(components):
        projected = space.mean + coefficients[:, :count] @ space.directions[:count]
        distances = np.linalg.norm((own - projected).reshape(len(own), -1, 3), axis=2)
        errors[:, column] = distances.mean(axis=1)
    return errors
