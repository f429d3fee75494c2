import numpy as np
import pytest

from corporeal.scans.units import UnitError, free_unit, guess_unit, known_unit, resolve_unit

BODY_EXTENT = (1.2, 2.3)


def cloud_with_diagonal(rng, diagonal: float) -> np.ndarray:
    points = rng.normal(size=(50, 3))
    return points * diagonal / np.linalg.norm(np.ptp(points, axis=0))


@pytest.mark.parametrize("metres", [0.091, 0.18, 0.32, 0.79])
@pytest.mark.parametrize("name", ["m", "cm", "mm"])
def test_every_hand_has_one_unit(rng, metres, name):
    scale = known_unit(name).metres_per_unit
    assert guess_unit(cloud_with_diagonal(rng, metres / scale)) == known_unit(name)


@pytest.mark.parametrize("metres", [1.3, 1.75, 2.25])
@pytest.mark.parametrize("name", ["m", "cm", "mm"])
def test_every_body_has_one_unit(rng, metres, name):
    scale = known_unit(name).metres_per_unit
    assert guess_unit(cloud_with_diagonal(rng, metres / scale), BODY_EXTENT) == known_unit(name)


@pytest.mark.parametrize(
    ("diagonal", "trouble"), [(85.0, "fits cm and mm"), (3.0, "fits none"), (20.8 * 320, "fits none")]
)
def test_what_does_not_decide_is_refused_with_advice(rng, diagonal, trouble):
    with pytest.raises(UnitError, match=trouble) as caught:
        guess_unit(cloud_with_diagonal(rng, diagonal))
    assert "--unit" in str(caught.value) and "free" in str(caught.value)


def test_free_gives_a_hand_whatever_the_numbers_are(rng):
    for diagonal in (1e-3, 1.0, 6600.0):
        points = cloud_with_diagonal(rng, diagonal)
        unit = free_unit(points)
        assert unit.name == "free"
        assert 0.08 < np.linalg.norm(np.ptp(points, axis=0)) * unit.metres_per_unit < 0.9


def test_resolve_says_what_it_did(rng):
    points = cloud_with_diagonal(rng, 320.0)
    assert resolve_unit(points, "mm") == (known_unit("mm"), ())
    unit, (sentence,) = resolve_unit(points, "auto")
    assert unit.name == "mm" and "guessed: mm" in sentence
    unit, (sentence,) = resolve_unit(points, "free")
    assert "provisional" in sentence


@pytest.mark.parametrize("metres", [0.14, 0.18, 0.32, 0.5])
@pytest.mark.parametrize(
    ("true", "told"), [("mm", "cm"), ("mm", "m"), ("cm", "m"), ("cm", "mm"), ("m", "mm"), ("m", "cm")]
)
def test_a_wrong_unit_is_refused_and_the_likely_one_named(rng, metres, true, told):
    points = cloud_with_diagonal(rng, metres / known_unit(true).metres_per_unit)
    with pytest.raises(UnitError, match=f"likely in.*{true}") as caught:
        resolve_unit(points, told)
    assert f"--unit {told}" in str(caught.value)
    assert resolve_unit(points, true) == (known_unit(true), ())


def test_the_expected_size_is_the_callers(rng):
    points = cloud_with_diagonal(rng, 1750.0)
    assert resolve_unit(points, "mm", BODY_EXTENT) == (known_unit("mm"), ())
    with pytest.raises(UnitError, match="give --unit mm"):
        resolve_unit(points, "cm", BODY_EXTENT)


def test_points_in_one_place_have_no_unit():
    with pytest.raises(UnitError, match="no extent"):
        guess_unit(np.ones((5, 3)))
    with pytest.raises(ValueError, match="expected one of"):
        known_unit("free")
