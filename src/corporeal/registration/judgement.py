"""Is a registration good? A status with its reason, from measured signals."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from corporeal.registration.measures import SurfaceDistances
from corporeal.registration.registration import Status

if TYPE_CHECKING:
    from corporeal.registration.stages import Fitter


@dataclass(frozen=True)
class Verdict:
    """Status, the sentence that explains it, and the signals behind it."""

    status: Status
    reason: str
    signals: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Bounds:
    """Beyond the first number of a pair a registration is doubtful, beyond the second it has failed.

    Attributes:
        s2m_mean_mm: mean scan-to-registration distance.
        model_s2m_mean_mm: mean scan-to-model distance: what free vertices had to make up for.
        unscored_share: share of the hand's points that had to be left out of the score.
        shape_norm: root mean square of the shape coefficients (1 is an average person).
        largest_shape: largest shape coefficient, whatever its sign.
        penetration_mm: how deep one finger stands in another.
    """

    s2m_mean_mm: tuple[float, float] = (1.0, 3.0)
    model_s2m_mean_mm: tuple[float, float] = (3.5, 8.0)
    unscored_share: tuple[float, float] = (0.10, 0.5)
    shape_norm: tuple[float, float] = (2.5, 5.0)
    largest_shape: tuple[float, float] = (6.0, 12.0)
    penetration_mm: tuple[float, float] = (2.0, 12.0)


def judge(
    fitter: Fitter,
    vector: np.ndarray,
    vertices: np.ndarray,
    distances: SurfaceDistances,
    model_distances: SurfaceDistances,
    bounds: Bounds | None = None,
) -> Verdict:
    """Status of a finished fit."""
    bounds = bounds or Bounds()
    shape = fitter.fields.parameters(vector).shape
    signals = {
        "s2m_mean_mm": distances.summary_mm()["mean"],
        "model_s2m_mean_mm": model_distances.summary_mm()["mean"],
        "unscored_share": 1 - distances.scored_share,
        "shape_norm": float(np.sqrt(np.mean(shape**2))) if len(shape) else 0.0,
        "largest_shape": float(np.abs(shape).max(initial=0.0)),
        "penetration_mm": 1e3 * _deepest(fitter, vertices),
    }
    return verdict_of(signals, bounds)


def verdict_of(signals: dict[str, float], bounds: Bounds) -> Verdict:
    """Worst signal decides; a signal that is not a number has failed."""
    doubtful, failed = [], []
    for name, value in signals.items():
        soft, hard = getattr(bounds, name)
        words = f"{name.replace('_', ' ')} {value:.2f} (at most {soft:g})"
        if not value <= hard:
            failed.append(words)
        elif value > soft:
            doubtful.append(words)
    if failed:
        return Verdict("failed", "; ".join(failed), signals)
    if doubtful:
        return Verdict("doubtful", "; ".join(doubtful), signals)
    return Verdict("ok", "all signals within bounds", signals)


def _deepest(fitter: Fitter, vertices: np.ndarray) -> float:
    return 0.0 if fitter.parts is None else fitter.parts.penetration(vertices).deepest
