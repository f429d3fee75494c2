"""Is a registration good? A status with its reason, from measured signals."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from corporeal.registration.registration import Status

_GUIDED = "landmark_median_mm"
"""The signal that only a fit with landmarks has."""


@dataclass(frozen=True)
class Verdict:
    """Status, the sentence that explains it, and the signals behind it."""

    status: Status
    reason: str
    signals: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Bounds:
    """Beyond the first number of a pair a registration is doubtful, beyond the second it has failed.

    The numbers are for a scan of any scanner: some close the gaps between fingers, and a good registration
    does not follow them there. For the scans of one known scanner ``for_sessions`` is sharper.

    Attributes:
        s2m_mean_mm: mean scan-to-registration distance.
        s2m_p95_mm: its 95th percentile.
        misfit_rms_mm: root mean square, over the area, of the scan's mean offset around a vertex: what is
            left of s2m when the scanner's noise is averaged out.
        misfit_share: share of the area where that offset is over 1 mm.
        model_s2m_mean_mm: mean scan-to-model distance: what free vertices had to make up for.
        unscored_share: share of the hand's points that had to be left out of the score.
        turned_share: share of the scored points whose normal points against the registration's.
        far_share: share of the registration's area that lies over 3 mm from a scan that was seen there.
        hole_share: share of its area over 3 mm from the scan where nothing was seen: guessed.
        shape_norm: root mean square of the shape coefficients (1 is an average person).
        largest_shape: largest shape coefficient, whatever its sign.
        pose_deviation: distance from the model's pose prior per degree of freedom, in standard deviations.
        beyond_limits_degrees: transgression of the anatomical limits, over all joints.
        edge_strain_rms: relative change of the edges' lengths against the fitted model, root mean square.
        edge_strain_p99: its 99th percentile.
        free_mean_mm: mean distance of the free vertices from the fitted model.
        free_p99_mm: its 99th percentile.
        penetration_mm: how deep one finger stands in another.
        landmark_median_mm: median distance from the landmarks that were found or given.
        landmark_p90_mm: its 90th percentile.
        together: so many signals beyond their first bound have failed.
        together_unguided: so many where no landmarks speak for the fit.
    """

    s2m_mean_mm: tuple[float, float] = (1.0, 3.0)
    s2m_p95_mm: tuple[float, float] = (2.5, 10.0)
    misfit_rms_mm: tuple[float, float] = (0.6, 6.0)
    misfit_share: tuple[float, float] = (0.06, 0.5)
    model_s2m_mean_mm: tuple[float, float] = (3.5, 8.0)
    unscored_share: tuple[float, float] = (0.10, 0.5)
    turned_share: tuple[float, float] = (0.05, 0.3)
    far_share: tuple[float, float] = (0.06, 0.3)
    hole_share: tuple[float, float] = (0.35, 0.8)
    shape_norm: tuple[float, float] = (2.5, 5.0)
    largest_shape: tuple[float, float] = (6.0, 12.0)
    pose_deviation: tuple[float, float] = (4.0, 8.0)
    beyond_limits_degrees: tuple[float, float] = (30.0, 120.0)
    edge_strain_rms: tuple[float, float] = (0.10, 0.4)
    edge_strain_p99: tuple[float, float] = (0.35, 2.0)
    free_mean_mm: tuple[float, float] = (2.5, 8.0)
    free_p99_mm: tuple[float, float] = (6.0, 20.0)
    penetration_mm: tuple[float, float] = (2.0, 12.0)
    landmark_median_mm: tuple[float, float] = (15.0, 50.0)
    landmark_p90_mm: tuple[float, float] = (40.0, 120.0)
    together: int = 6
    together_unguided: int = 6

    @classmethod
    def for_sessions(cls) -> Bounds:
        """For many scans of one scanner that does not close gaps, such as MANO's stereo units.

        What tells is the share of misfit, chosen on simulated scans whose truth is known: a finger in the
        wrong place leaves at least a hundredth of the seen area unexplained (docs/registration.md).
        """
        return cls(
            s2m_mean_mm=(0.4, 3.0),
            misfit_rms_mm=(0.4, 3.0),
            misfit_share=(0.010, 0.2),
            model_s2m_mean_mm=(1.5, 5.0),
            turned_share=(0.004, 0.1),
            far_share=(0.01, 0.2),
            hole_share=(0.3, 0.6),
            edge_strain_p99=(0.25, 1.0),
            landmark_p90_mm=(30.0, 100.0),
        )

    @classmethod
    def for_bodies(cls) -> Bounds:
        """For people: ten times as large, seen by coarser scanners, in hair and clothes that no model has.

        What was not seen has no second bound: of a head or a bust the rest of the body is guessed, which is
        said (``doubtful``), and is no failure. Without landmarks that is all that may be said: a hand taken
        for a person passes five first bounds and no second one, a head alone one.
        """
        return cls(
            s2m_mean_mm=(3.0, 12.0),
            s2m_p95_mm=(10.0, 50.0),
            misfit_rms_mm=(4.0, 25.0),
            misfit_share=(0.35, 0.9),
            model_s2m_mean_mm=(10.0, 30.0),
            far_share=(0.15, 0.5),
            hole_share=(0.5, 1.0),
            free_mean_mm=(10.0, 30.0),
            free_p99_mm=(40.0, 150.0),
            penetration_mm=(20.0, 80.0),
            landmark_median_mm=(40.0, 150.0),
            landmark_p90_mm=(100.0, 400.0),
            together_unguided=3,
        )

    @classmethod
    def for_heads(cls) -> Bounds:
        """For heads, on which hair, beard and the folds of ears are what no model has.

        Many scans were closed by hand and have the inside of lips, nostrils and lids, whose points lie deep
        and turned away. A mask of the face alone leaves most of the head to be guessed: said, but no failure.
        """
        return cls(
            s2m_mean_mm=(2.5, 8.0),
            s2m_p95_mm=(15.0, 30.0),
            turned_share=(0.2, 0.5),
            misfit_rms_mm=(2.0, 12.0),
            misfit_share=(0.25, 0.8),
            model_s2m_mean_mm=(5.0, 15.0),
            far_share=(0.15, 0.5),
            hole_share=(0.5, 1.0),
            free_mean_mm=(5.0, 15.0),
            free_p99_mm=(20.0, 60.0),
            penetration_mm=(20.0, 80.0),
            landmark_median_mm=(10.0, 40.0),
            landmark_p90_mm=(25.0, 100.0),
            together_unguided=3,
        )

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if name.startswith("together"):
                if value < 1:
                    raise ValueError(f"bounds: {name}: expected at least 1, got {value}")
            elif not 0 <= value[0] <= value[1]:
                raise ValueError(f"bounds: {name}: expected doubtful <= failed, not negative, got {value}")


def verdict_of(signals: Mapping[str, float], bounds: Bounds) -> Verdict:
    """The worst signal decides; one that is not a number has failed, and so have many that are doubtful.

    Args:
        signals: name -> value; a signal that could not be measured on this scan is absent.
        bounds: has a pair for every name.

    Raises:
        ValueError: a signal has no bounds, or there is none.
    """
    unknown = sorted(set(signals) - set(vars(bounds)))
    if unknown or not signals:
        raise ValueError(f"signals: {unknown[0]!r} has no bounds" if unknown else "signals: there are none")
    doubtful, failed = [], []
    for name, value in signals.items():
        soft, hard = getattr(bounds, name)
        limit = soft if value <= hard or math.isnan(value) else hard
        words = f"{name.replace('_', ' ')} {value:.3g} (at most {limit:g})"
        if not value <= hard:
            failed.append(words)
        elif value > soft:
            doubtful.append(words)
    if failed:
        return Verdict("failed", "; ".join(failed), dict(signals))
    guided = _GUIDED in signals
    if len(doubtful) >= (bounds.together if guided else bounds.together_unguided):
        sentence = f"{len(doubtful)} signals out of bounds" + ("" if guided else " and no landmarks")
        return Verdict("failed", f"{sentence}: " + "; ".join(doubtful), dict(signals))
    if doubtful:
        return Verdict("doubtful", "; ".join(doubtful), dict(signals))
    return Verdict("ok", "all signals within bounds", dict(signals))
