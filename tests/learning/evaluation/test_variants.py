"""Models that are learned to be compared with: which registrations, how many, and whose."""

import dataclasses

import numpy as np
import pytest

from corporeal.learning.evaluation import variants
from corporeal.learning.evaluation.variants import MIRRORED, ONE_SIDED, drawn_evenly, planned_variants


@pytest.fixture
def both_sides(known_tube):
    """44 registrations of right hands, 44 of left ones, of eight people."""
    training = known_tube.training
    hands = [
        f"{person}/{'right' if number % 2 else 'left'}" for number, person in enumerate(training.subjects)
    ]
    return dataclasses.replace(training, hands=tuple(hands))


@pytest.fixture
def small(monkeypatch):
    """The paper's size, for a training set of 88."""
    monkeypatch.setattr(variants, "A_SIDE", 40)
    monkeypatch.setattr(variants, "_MIRRORED_COUNTS", (20, 40, 500))
    monkeypatch.setattr(variants, "_ONE_SIDED_COUNTS", (20, 500))


@pytest.mark.usefixtures("small")
def test_counts_sides_and_options(both_sides):
    planned, notes = planned_variants(both_sides, "right")
    sizes = {variant.label: len(variant.training) for variant in planned}
    assert sizes == {
        "learned without correctives": 88, "constant regularisation": 88,
        "learned without equation 11": 88, "right only, 20": 20, "right only": 40,
        "mirrored, 20": 20, "mirrored, 40": 40, "mirrored": 80,
    }  # fmt: skip
    assert notes == ()
    assert [variant.options.correctives for variant in planned] == [False] + 7 * [True]
    assert [variant.options.neutral_first for variant in planned] == [True, True, False] + 5 * [True]
    assert [variant.options.regularisation for variant in planned[:3]] == ["geodesic", "constant", "geodesic"]
    for variant in planned[3:]:
        lefts = sum(hand.endswith("/left") for hand in variant.training.hands)
        assert lefts == (0 if variant.learning_curve == ONE_SIDED else len(variant.training) // 2)
        assert set(variant.training.subjects) == set(both_sides.subjects)


@pytest.mark.usefixtures("small")
def test_smaller_sets_lie_in_larger_ones_and_right_ones_in_mirrored_ones(both_sides):
    planned = {
        variant.label: set(variant.training.names) for variant in planned_variants(both_sides, "right")[0]
    }
    assert planned["mirrored, 20"] < planned["mirrored, 40"] < planned[MIRRORED]
    assert planned["right only, 20"] < planned[ONE_SIDED] < planned[MIRRORED]
    other = planned_variants(both_sides, "right", seed=1)[0]
    assert set(other[-1].training.names) != planned[MIRRORED]


def test_a_set_that_is_too_small_says_so(both_sides, known_tube):
    planned, notes = planned_variants(both_sides, "right")
    assert {variant.label: len(variant.training) for variant in planned[3:]} == {ONE_SIDED: 44, MIRRORED: 88}
    assert "44 registrations a side, the paper has 777" in notes[0]
    planned, notes = planned_variants(known_tube.training, "right")
    assert len(planned) == 3
    assert "both sides" in notes[0]


def test_the_digest_tells_data_options_and_start_apart(both_sides):
    variant = planned_variants(both_sides, "right")[0][0]
    same = planned_variants(both_sides, "right")[0][0]
    moved = dataclasses.replace(both_sides, vertices=both_sides.vertices + 1e-6)
    others = [
        dataclasses.replace(variant, training=moved).digest("a"),
        dataclasses.replace(variant, options=dataclasses.replace(variant.options, sweeps=3)).digest("a"),
        variant.digest("b"),
    ]
    assert variant.digest("a") == same.digest("a")
    assert len({variant.digest("a"), *others}) == 4


def test_every_beginning_is_spread_over_subjects(rng):
    subjects = [f"s{number}" for number in rng.permutation(np.repeat(np.arange(4), [2, 5, 9, 9]))]
    drawn = drawn_evenly(subjects, np.arange(1, 25), 3)
    assert sorted(drawn) == list(range(1, 25))
    for count in range(1, 25):
        held = [sum(subjects[index] == f"s{person}" for index in drawn[:count]) for person in range(4)]
        available = [sum(subjects[index] == f"s{person}" for index in range(1, 25)) for person in range(4)]
        assert all(
            own == all_of_it or own >= max(held) - 1 for own, all_of_it in zip(held, available, strict=True)
        )
