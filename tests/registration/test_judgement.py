"""The verdict follows its worst signal, and many doubtful ones together."""

import math
from dataclasses import fields

import pytest

from corporeal.registration.judgement import Bounds, verdict_of

NAMES = [field.name for field in fields(Bounds) if not field.name.startswith("together")]
GOOD = dict.fromkeys(NAMES, 0.0)


@pytest.mark.parametrize("bounds", [Bounds(), Bounds.for_sessions(), Bounds.for_bodies()])
@pytest.mark.parametrize("name", NAMES)
def test_each_signal_alone_makes_doubtful_then_failed(name, bounds):
    soft, hard = getattr(bounds, name)
    assert verdict_of({**GOOD, name: soft}, bounds).status == "ok"
    doubtful = verdict_of({**GOOD, name: 0.5 * (soft + hard)}, bounds)
    failed = verdict_of({**GOOD, name: 2 * hard}, bounds)
    assert doubtful.status == "doubtful" and name.replace("_", " ") in doubtful.reason
    assert f"at most {soft:g}" in doubtful.reason
    assert failed.status == "failed" and f"at most {hard:g}" in failed.reason


def test_a_number_that_is_none_has_failed():
    assert verdict_of({**GOOD, "s2m_mean_mm": math.nan}, Bounds()).status == "failed"


def test_many_doubtful_signals_together_have_failed():
    bounds = Bounds(together=3)
    soft = {name: 1.01 * getattr(bounds, name)[0] for name in NAMES[:3]}
    assert verdict_of({**GOOD, **dict(list(soft.items())[:2])}, bounds).status == "doubtful"
    verdict = verdict_of({**GOOD, **soft}, bounds)
    assert verdict.status == "failed" and verdict.reason.startswith("3 signals")


def test_without_landmarks_fewer_doubts_are_allowed():
    bounds = Bounds(together=5, together_unguided=2)
    soft = {name: 1.01 * getattr(bounds, name)[0] for name in NAMES[:2]}
    unguided = {name: value for name, value in GOOD.items() if not name.startswith("landmark")}
    assert verdict_of({**GOOD, **soft}, bounds).status == "doubtful"
    assert verdict_of({**unguided, **dict(list(soft.items())[:1])}, bounds).status == "doubtful"
    verdict = verdict_of({**unguided, **soft}, bounds)
    assert verdict.status == "failed" and verdict.reason.startswith(
        "2 signals out of bounds and no landmarks"
    )


def test_signals_that_could_not_be_measured_are_not_judged():
    assert verdict_of({"s2m_mean_mm": 0.2}, Bounds()).status == "ok"
    with pytest.raises(ValueError, match="there are none"):
        verdict_of({}, Bounds())
    with pytest.raises(ValueError, match="'beauty' has no bounds"):
        verdict_of({"beauty": 1.0}, Bounds())


def test_bounds_out_of_order_are_refused():
    with pytest.raises(ValueError, match="misfit_share"):
        Bounds(misfit_share=(0.5, 0.1))
    with pytest.raises(ValueError, match="together"):
        Bounds(together=0)
    with pytest.raises(ValueError, match="together_unguided"):
        Bounds(together_unguided=0)


def test_sessions_are_judged_no_less_sharply():
    usual, session = Bounds(), Bounds.for_sessions()
    for name in NAMES:
        assert getattr(session, name)[0] <= getattr(usual, name)[0]
