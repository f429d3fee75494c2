"""The paired bootstrap: coverage, pairing, subjects as the unit."""

import numpy as np
import pytest

from corporeal.learning.evaluation.bootstrap import (
    learning_curve_point,
    mean_interval,
    ratio_interval,
    ratio_of_curves,
)
from corporeal.learning.evaluation.results import PoseCurve, ScanError, ScanResult, Summary


def curve_of(label, means, subjects, protocol="pose only", failed=()):
    scans = tuple(
        ScanResult(
            f"scan{number}",
            subject,
            "failed: far" if number in failed else "ok",
            (),
            ScanError(mean, mean, mean),
        )
        for number, (mean, subject) in enumerate(zip(means, subjects, strict=True))
    )
    n = len(means) - len(failed)
    return PoseCurve(label, protocol, (), (), (), n, len(set(subjects)), Summary.of(np.array(means)), scans)


def test_what_makes_a_scan_hard_drops_out_of_a_paired_ratio(rng):
    hard = rng.uniform(0.5, 5, size=40)
    subjects = [f"s{number % 6}" for number in range(40)]
    low, high = ratio_interval(0.7 * hard, hard, subjects)
    assert (low, high) == (pytest.approx(0.7), pytest.approx(0.7))
    assert np.ptp(mean_interval(hard, subjects)) > 0.2


def test_it_holds_the_true_ratio_about_as_often_as_it_says(rng):
    hits = 0
    for _ in range(60):
        level = np.repeat(rng.lognormal(0, 0.3, 20), 4)
        gain = np.repeat(rng.normal(0.8, 0.08, 20), 4) + 0.02 * rng.normal(size=80)
        low, high = ratio_interval(gain * level, level, list(np.repeat(np.arange(20), 4).astype(str)))
        hits += low <= 0.8 <= high
    assert 50 <= hits < 60


def test_scans_of_one_subject_are_not_counted_as_if_they_were_many(rng):
    person = rng.normal(1.0, 0.2, size=6)
    values = np.repeat(person, 20)
    by_subject = mean_interval(values, [f"s{n}" for n in np.repeat(np.arange(6), 20)])
    by_scan = mean_interval(values, [f"s{n}" for n in range(120)])
    assert np.ptp(by_subject) > 3 * np.ptp(by_scan)
    assert mean_interval(values, ["s"] * 120) is None


def test_a_seed_repeats_it_and_the_order_of_scans_does_not_matter(rng):
    a, b = rng.uniform(1, 2, size=(2, 36))
    subjects = [f"s{n % 12}" for n in range(36)]
    first = ratio_interval(a, b, subjects, seed=3)
    order = rng.permutation(36)
    turned = ratio_interval(a[order], b[order], [subjects[n] for n in order], seed=3)
    assert first == ratio_interval(a, b, subjects, seed=3)
    assert turned == pytest.approx(first)
    assert first != ratio_interval(a, b, subjects, seed=4)


def test_a_ratio_is_over_the_scans_that_both_were_fitted_to():
    subjects = ["s1", "s1", "s2", "s2"]
    on = curve_of("on", [1.0, 1.0, 1.0, 99.0], subjects, failed=(3,))
    off = curve_of("off", [2.0, 2.0, 99.0, 2.0], subjects, failed=(2,))
    ratio = ratio_of_curves("on / off", on, off, paper=0.72, limit=0.72)
    assert (ratio.value, ratio.n_subjects, ratio.interval, ratio.met) == (0.5, 1, None, True)
    with pytest.raises(ValueError, match="within one protocol"):
        ratio_of_curves("x", on, curve_of("free", [1.0] * 4, subjects, "pose and shape free"))
    with pytest.raises(ValueError, match="in common"):
        ratio_of_curves("x", on, curve_of("none", [1.0] * 4, subjects, failed=(0, 1, 2)))


def test_a_point_of_the_learning_curve_leaves_failed_scans_out():
    curve = curve_of("m", [1.0, 3.0, 99.0], ["s1", "s2", "s2"], failed=(2,))
    point = learning_curve_point("mirrored", curve, 777)
    assert (point.mean, point.n_registrations) == (2.0, 777)
    assert point.interval == (1.0, 3.0)
