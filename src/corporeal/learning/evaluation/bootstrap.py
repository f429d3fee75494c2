"""How sure a comparison is: a bootstrap over subjects, since scans of one person are alike."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from corporeal.learning.evaluation.results import Interval, LearningCurvePoint, PoseCurve, Ratio

_DRAWS = 10_000
_PERCENTILES = (2.5, 97.5)


def ratio_interval(
    numerator: Float[np.ndarray, " n"],
    denominator: Float[np.ndarray, " n"],
    subjects: Sequence[str],
    seed: int = 0,
) -> Interval | None:
    """95 % percentile interval of mean(numerator) / mean(denominator), paired.

    Subjects are drawn with replacement, with all of their scans in both errors: what makes a person or a scan
    hard is in both, and drops out of the ratio.

    Args:
        numerator: error of every scan.
        denominator: errors of the same scans.
        subjects: of the scans.
        seed: of the draws.

    Returns:
        The interval, or None for fewer than two subjects.
    """
    above, below = (_sums(values, subjects) for values in (numerator, denominator))
    count = len(above)
    if count < 2:
        return None
    draws = np.random.default_rng(seed).integers(count, size=(_DRAWS, count))
    low, high = np.percentile(above[draws].sum(axis=1) / below[draws].sum(axis=1), _PERCENTILES)
    return float(low), float(high)


def mean_interval(values: Float[np.ndarray, " n"], subjects: Sequence[str], seed: int = 0) -> Interval | None:
    """The same for the mean over scans."""
    return ratio_interval(values, np.ones_like(values), subjects, seed)


def ratio_of_curves(
    name: str,
    numerator: PoseCurve,
    denominator: PoseCurve,
    *,
    paper: float | None = None,
    limit: float | None = None,
    seed: int = 0,
) -> Ratio:
    """Mean s2m of one model over that of another with the full pose, over the scans that both were fitted to.

    Raises:
        ValueError: curves of two protocols, or no scan in common.
    """
    if numerator.protocol != denominator.protocol:
        raise ValueError(
            f"{name}: {numerator.label!r} was fitted by {numerator.protocol!r}, {denominator.label!r} by "
            f"{denominator.protocol!r}; compare within one protocol"
        )
    over, under = (
        {scan.name: scan for scan in curve.scans if scan.status == "ok"} for curve in (numerator, denominator)
    )
    common = sorted(set(over) & set(under))
    if not common:
        raise ValueError(f"{name}: {numerator.label!r} and {denominator.label!r} have no scan in common")
    above = np.array([over[scan].full.mean for scan in common])
    below = np.array([under[scan].full.mean for scan in common])
    subjects = [over[scan].subject for scan in common]
    return Ratio(
        name=name,
        numerator=numerator.label,
        denominator=denominator.label,
        protocol=numerator.protocol,
        value=float(above.mean() / below.mean()),
        interval=ratio_interval(above, below, subjects, seed),
        n_subjects=len(set(subjects)),
        paper=paper,
        limit=limit,
    )


def learning_curve_point(
    label: str, curve: PoseCurve, n_registrations: int, seed: int = 0
) -> LearningCurvePoint:
    """Mean s2m with the full pose of a model learned from so many registrations."""
    scored = [scan for scan in curve.scans if scan.status == "ok"]
    values = np.array([scan.full.mean for scan in scored])
    return LearningCurvePoint(
        label=label,
        protocol=curve.protocol,
        n_registrations=n_registrations,
        mean=float(values.mean()) if len(values) else float("nan"),
        interval=mean_interval(values, [scan.subject for scan in scored], seed),
        n_subjects=curve.n_subjects,
    )


def _sums(values: Float[np.ndarray, " n"], subjects: Sequence[str]) -> Float[np.ndarray, " s"]:
    """Sum of every subject's scans, subjects sorted."""
    if len(values) != len(subjects):
        raise ValueError(f"subjects: {len(subjects)} for {len(values)} scans")
    people, index = np.unique(np.array(subjects, dtype=np.str_), return_inverse=True)
    return np.bincount(index, values, minlength=len(people))
