"""What an evaluation found: plain records that become JSON, from which tables and plots are drawn.

Lengths are millimetres, shares lie between 0 and 1, intervals are 95 % ones. A curve's ``components[i]``
belongs to ``mean[i]`` and ``sd[i]``; ``components`` is empty where only the full pose space was fitted. A
number that is not known is null, for instance an interval with too few subjects.
``EvaluationResults.to_json()`` gives::

    {
      "format": "corporeal-evaluation-1",
      "compactness": [
        {"label": "learned", "space": "pose", "components": [1, 2, 3], "shares": [0.4, 0.6, 0.7],
         "paper": {"components": [6, 10, 15], "shares": [0.81, 0.9, 0.95]}},
        {"label": "learned", "space": "shape", "components": [1, 2], "shares": [0.5, 0.7], "paper": null}
      ],
      "pose_generalisation": [
        {"label": "learned", "protocol": "pose only", "components": [1, 6, 45], "mean": [1.9, 1.1, 0.6],
         "sd": [0.5, 0.3, 0.1], "n_scans": 50, "n_subjects": 6,
         "full": {"mean": 0.55, "median": 0.54, "p95": 0.8, "sd": 0.1}, "limit": 0.6,
         "scans": [{"name": "s40_p02_right", "subject": "s40", "status": "ok",
                    "by_components": [1.8, 1.0, 0.6], "full": {"mean": 0.56, "median": 0.41, "p95": 1.5}}]}
      ],
      "shape_generalisation": [
        {"label": "learned", "protocol": "leave one subject out", "components": [0, 1, 2],
         "mean": [3.0, 1.8, 1.5], "sd": [0.9, 0.4, 0.3], "n_subjects": 31, "n_hands": 62,
         "hands": [{"name": "s01/left", "subject": "s01", "by_components": [2.9, 1.7, 1.6]}]}
      ],
      "ratios": [
        {"name": "correctives on / off", "numerator": "learned", "denominator": "learned, correctives off",
         "protocol": "pose only", "value": 0.6, "interval": [0.55, 0.66], "n_subjects": 6, "paper": 0.72,
         "limit": 0.72, "met": true}
      ],
      "locality": [
        {"label": "geodesic", "weighting": "plain", "distance_mm": 40.0, "share": 0.02,
         "by_joint": [{"joint": "index1", "share": 0.01}]}
      ],
      "truth": [
        {"label": "learned", "r_squared": 0.7, "r_squared_median": 0.71, "r_squared_worst": 0.5,
         "aligned": false,
         "error": {"mean": 0.6, "median": 0.5, "p95": 1.4, "sd": 0.3},
         "error_without": {"mean": 1.2, "median": 0.9, "p95": 3.0, "sd": 0.8},
         "joint_error": {"mean": 1.1, "median": 1.0, "p95": 1.9, "sd": 0.4},
         "n_scans": 20, "limit": 0.6, "met": true}
      ],
      "learning_curve": [
        {"label": "mirrored", "protocol": "pose only", "n_registrations": 777, "mean": 0.6,
         "interval": [0.5, 0.7], "n_subjects": 6}
      ],
      "notes": ["50 scans of 6 subjects, none of them learned from."]
    }

A summary under ``full`` is over the means of the scans; one under ``scans`` is over the points of one scan.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from corporeal.registration.session.records import finite

FORMAT = "corporeal-evaluation-1"
Protocol = Literal["pose only", "pose and shape free"]
"""Of paper 5.1: a fixed personal template, or the model's shape space solved for with the pose."""
Interval = tuple[float, float]


@dataclass(frozen=True)
class Summary:
    """Of several numbers: mean, median, 95th percentile and standard deviation."""

    mean: float
    median: float
    p95: float
    sd: float

    @classmethod
    def of(cls, values: Float[np.ndarray, " n"]) -> Summary:
        """The summary of some numbers; NaN where there are none, sd 0 where there is one."""
        if not len(values):
            return cls(*[float("nan")] * 4)
        return cls(
            float(values.mean()), float(np.median(values)), float(np.percentile(values, 95)), spread(values)
        )


@dataclass(frozen=True)
class ScanError:
    """Scan to fitted model surface of one scan, over its scored points, mm."""

    mean: float
    median: float
    p95: float


@dataclass(frozen=True)
class PaperShares:
    """Explained variance in the paper, by number of components."""

    components: tuple[int, ...]
    shares: tuple[float, ...]


@dataclass(frozen=True)
class CompactnessCurve:
    """Share of the training set's variance that the first components explain."""

    label: str
    space: Literal["pose", "shape"]
    components: tuple[int, ...]
    shares: tuple[float, ...]
    paper: PaperShares | None = None


@dataclass(frozen=True)
class ScanResult:
    """One scan of a pose curve: mean s2m by number of components, and with the full pose, mm."""

    name: str
    subject: str
    status: str
    by_components: tuple[float, ...]
    full: ScanError


@dataclass(frozen=True)
class PoseCurve:
    """Generalisation of the pose space: s2m over scans by number of pose components, mm.

    At most ``limit`` is asked of the mean with the full pose; None where nothing is asked.
    """

    label: str
    protocol: Protocol
    components: tuple[int, ...]
    mean: tuple[float, ...]
    sd: tuple[float, ...]
    n_scans: int
    n_subjects: int
    full: Summary
    scans: tuple[ScanResult, ...]
    limit: float | None = None


@dataclass(frozen=True)
class HandResult:
    """One left-out template: mean absolute vertex error by number of shape components, mm."""

    name: str
    subject: str
    by_components: tuple[float, ...]


@dataclass(frozen=True)
class ShapeCurve:
    """Generalisation of the shape space: vertex error over left-out templates, mm."""

    label: str
    protocol: Literal["leave one subject out"]
    components: tuple[int, ...]
    mean: tuple[float, ...]
    sd: tuple[float, ...]
    n_subjects: int
    n_hands: int
    hands: tuple[HandResult, ...]


@dataclass(frozen=True)
class Ratio:
    """Mean error of one model over that of another on the same scans; at most ``limit`` is allowed."""

    name: str
    numerator: str
    denominator: str
    protocol: Protocol
    value: float
    interval: Interval | None
    n_subjects: int
    paper: float | None = None
    limit: float | None = None

    @property
    def met(self) -> bool | None:
        """Whether the value is within the limit; None without one."""
        return None if self.limit is None else bool(self.value <= self.limit)


@dataclass(frozen=True)
class JointShare:
    """Share of one joint's corrective energy that lies far from it."""

    joint: str
    share: float


@dataclass(frozen=True)
class Locality:
    """Share of corrective energy farther than a geodesic distance from its joint."""

    label: str
    weighting: Literal["plain", "training poses"]
    distance_mm: float
    share: float
    by_joint: tuple[JointShare, ...] = ()


@dataclass(frozen=True)
class TruthResult:
    """A model at true pose and template against the true surface; errors in mm over vertices and scans."""

    label: str
    r_squared: float
    r_squared_median: float
    r_squared_worst: float
    aligned: bool
    error: Summary
    error_without: Summary
    joint_error: Summary | None
    n_scans: int
    limit: float | None = None

    @property
    def met(self) -> bool | None:
        """Whether the pooled value reaches the limit; None without one."""
        return None if self.limit is None else bool(self.r_squared >= self.limit)


@dataclass(frozen=True)
class LearningCurvePoint:
    """Held-out s2m, mm, of a model learned from so many registrations."""

    label: str
    protocol: Protocol
    n_registrations: int
    mean: float
    interval: Interval | None
    n_subjects: int


@dataclass(frozen=True)
class EvaluationResults:
    """All sections of an evaluation; those that were not asked for are empty."""

    compactness: tuple[CompactnessCurve, ...] = ()
    pose_generalisation: tuple[PoseCurve, ...] = ()
    shape_generalisation: tuple[ShapeCurve, ...] = ()
    ratios: tuple[Ratio, ...] = ()
    locality: tuple[Locality, ...] = ()
    truth: tuple[TruthResult, ...] = ()
    learning_curve: tuple[LearningCurvePoint, ...] = ()
    notes: tuple[str, ...] = field(default=())

    def to_json(self) -> dict[str, Any]:
        """As dictionaries, lists and finite numbers; see the module for an example."""
        content = asdict(self)
        for section in ("ratios", "truth"):
            for entry, record in zip(content[section], getattr(self, section), strict=True):
                entry["met"] = record.met
        return finite({"format": FORMAT, **content})


def spread(values: Float[np.ndarray, " n"]) -> float:
    """Standard deviation of a sample (n - 1); 0 for a single value."""
    return float(values.std(ddof=1)) if len(values) > 1 else 0.0
