"""The JSON of an evaluation: what it is drawn from later."""

import json

import numpy as np
import pytest

from corporeal.learning.evaluation import results as module
from corporeal.learning.evaluation.results import (
    EvaluationResults,
    LearningCurvePoint,
    Locality,
    PaperShares,
    PoseCurve,
    Ratio,
    ScanError,
    ScanResult,
    ShapeCurve,
    Summary,
    TruthResult,
    spread,
)


def example():
    summary = Summary(1.0, 0.9, 2.0, 0.1)
    scan = ScanResult("a", "s1", "ok", (2.0, 1.0), ScanError(1.0, float("nan"), 2.0))
    return EvaluationResults(
        compactness=(
            module.CompactnessCurve("m", "pose", (1, 2), (0.5, 0.9), PaperShares((6, 10), (0.81, 0.9))),
        ),
        pose_generalisation=(
            PoseCurve("m", "pose only", (1, 6), (2.0, 1.0), (0.1, 0.1), 1, 1, summary, (scan,)),
        ),
        shape_generalisation=(
            ShapeCurve(
                "m", "leave one subject out", (0, 1), (3.0, 2.0), (0.1, 0.1), 1, 1,
                (module.HandResult("s1/left", "s1", (3.0, 2.0)),),
            ),
        ),
        ratios=(Ratio("on / off", "m", "n", "pose only", 0.7, None, 1, 0.72, 0.72),),
        locality=(Locality("m", "plain", 40.0, 0.1, (module.JointShare("index1", 0.1),)),),
        truth=(TruthResult("m", 0.5, 0.5, 0.4, False, summary, summary, None, 3, 0.6),),
        learning_curve=(LearningCurvePoint("m", "pose only", 100, 0.8, (0.7, 0.9), 6),),
        notes=("a note",),
    )  # fmt: skip


def keys_of(value):
    """The keys of nested dictionaries, lists by their first entry."""
    if isinstance(value, dict):
        return {key: keys_of(item) for key, item in value.items()}
    if isinstance(value, list) and value and isinstance(value[0], dict):
        return keys_of(value[0])
    return None


def test_the_example_in_the_docstring_has_the_keys_that_are_written():
    text = module.__doc__.split("gives::")[1].split("\n    }\n")[0] + "}"
    documented = keys_of(json.loads(text))
    written = keys_of(json.loads(json.dumps(example().to_json(), allow_nan=False)))
    documented["truth"]["joint_error"] = None  # it is None in the example above
    assert documented == written


def test_limits_are_judged_and_what_is_not_finite_is_null():
    content = example().to_json()
    assert content["ratios"][0]["met"] is True
    assert content["truth"][0]["met"] is False
    assert content["pose_generalisation"][0]["scans"][0]["full"]["median"] is None
    assert EvaluationResults().to_json()["ratios"] == []


def test_summary(rng):
    values = rng.normal(size=40)
    summary = Summary.of(values)
    assert summary.sd == pytest.approx(np.sqrt(((values - values.mean()) ** 2).sum() / 39))
    assert summary.p95 == pytest.approx(np.percentile(values, 95))
    assert spread(values[:1]) == 0
    assert np.isnan(Summary.of(np.zeros(0)).mean)
