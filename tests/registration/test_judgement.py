"""The verdict follows its worst signal."""

import math

from corporeal.registration.judgement import Bounds, verdict_of

GOOD = {
    "s2m_mean_mm": 0.3,
    "model_s2m_mean_mm": 1.0,
    "unscored_share": 0.02,
    "shape_norm": 1.0,
    "largest_shape": 2.0,
    "penetration_mm": 0.0,
}


def test_good_signals_are_ok():
    assert verdict_of(GOOD, Bounds()).status == "ok"


def test_each_signal_alone_makes_doubtful_then_failed():
    for name in GOOD:
        soft, hard = getattr(Bounds(), name)
        doubtful = verdict_of({**GOOD, name: 0.5 * (soft + hard)}, Bounds())
        failed = verdict_of({**GOOD, name: 2 * hard}, Bounds())
        assert doubtful.status == "doubtful" and name.replace("_", " ") in doubtful.reason
        assert failed.status == "failed" and name.replace("_", " ") in failed.reason


def test_a_number_that_is_none_has_failed():
    assert verdict_of({**GOOD, "s2m_mean_mm": math.nan}, Bounds()).status == "failed"
