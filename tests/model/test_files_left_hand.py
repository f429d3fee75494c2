"""The known fault of left-hand MANO files: found, warned about, repaired on request."""

import numpy as np
import pytest

from corporeal.model.files import LeftHandWarning, ModelFileError, check_left_hand, load_model, save_model
from corporeal.model.mirror import mirror_model


def _hand_pair(official, tmp_path, rng, *, faulty):
    right = load_model(official.write_npz(tmp_path / "right.npz", official.official_arrays("mano", rng)))
    left = mirror_model(right)
    if faulty:
        left = left.replace(shape_directions=left.shape_directions * [[[-1.0], [1], [1]]])
    # Official pairs agree in all but the last digits.
    noise = 1 + 1e-6 * rng.normal(size=left.shape_directions.shape)
    left = left.replace(shape_directions=left.shape_directions * noise)
    save_model(left, tmp_path / "left.npz", layout="official")
    return tmp_path / "right.npz", tmp_path / "left.npz"


def test_a_left_hand_alone_is_warned_about(official, tmp_path, rng):
    _, left = _hand_pair(official, tmp_path, rng, faulty=False)
    with pytest.warns(LeftHandWarning, match="give the right-hand file"):
        assert load_model(left).side == "left"


def test_a_sound_left_hand_is_accepted_without_a_word(official, tmp_path, rng):
    right, left = _hand_pair(official, tmp_path, rng, faulty=False)
    model = load_model(left, right=right, repair_left=True)
    assert check_left_hand(model, load_model(right)) == "sound"
    np.testing.assert_array_equal(model.shape_directions, load_model(left, right=right).shape_directions)


def test_a_faulty_left_hand_is_found_and_repaired_on_request(official, tmp_path, rng):
    right, left = _hand_pair(official, tmp_path, rng, faulty=True)
    with pytest.warns(LeftHandWarning, match="not mirrored"):
        faulty = load_model(left, right=right)
    assert check_left_hand(faulty, load_model(right)) == "faulty"
    repaired = load_model(left, right=load_model(right), repair_left=True)
    assert check_left_hand(repaired, load_model(right)) == "sound"
    expected = mirror_model(load_model(right))
    np.testing.assert_allclose(repaired.shape_directions, expected.shape_directions, rtol=1e-5)
    assert "mirrored" in repaired.notes["left_hand"]


@pytest.mark.parametrize("case", ["unrelated", "two rights", "exchanged", "no right hand"])
def test_hands_that_are_no_pair_are_refused(official, case, tmp_path, rng):
    right, left = _hand_pair(official, tmp_path, rng, faulty=False)
    other = official.write_npz(tmp_path / "other.npz", official.official_arrays("mano", rng))
    path, options, message = {
        "unrelated": (left, {"right": other}, "no mirror image"),
        "two rights": (other, {"right": right}, "sides are right and right"),
        "exchanged": (right, {"right": right}, "sides are right and right"),
        "no right hand": (left, {"repair_left": True}, "give the right-hand file"),
    }[case]
    with pytest.raises(ModelFileError, match=message):
        load_model(path, **options)
