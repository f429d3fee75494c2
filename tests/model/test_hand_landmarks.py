"""Keypoints and parts derived from joints and weights agree with those that the open hand stores."""

import numpy as np

from corporeal.model.files import load_model, open_model, save_model
from corporeal.model.hand_landmarks import HAND_21, hand_landmarks, hand_parts


def test_derived_keypoints_lie_where_the_stored_ones_do():
    hand = open_model("hand")
    joints = hand.joint_regressor @ hand.template
    derived = hand_landmarks(hand.template, joints, hand.skinning_weights, hand.joint_names)
    stored = hand.landmarks[HAND_21]
    assert derived.names == stored.names
    gap = np.linalg.norm(
        derived.positions(hand.template, joints) - stored.positions(hand.template, joints), axis=1
    )
    assert gap.max() < 6e-3 and np.delete(gap, [4, 8, 12, 16, 20]).max() < 1e-9


def test_derived_parts_are_the_stored_ones():
    hand = open_model("start_hand")
    derived = hand_parts(hand.skinning_weights, hand.joint_names)
    for name, members in hand.parts.items():
        assert np.array_equal(derived[name], members)


def test_an_official_hand_file_gets_both(tmp_path):
    path = tmp_path / "MANO_RIGHT.pkl"
    save_model(open_model("hand"), path, layout="official")
    model = load_model(path)
    assert HAND_21 in model.landmarks and set(model.parts) == set(open_model("hand").parts)
