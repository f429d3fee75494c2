"""The start hand's soft body, and the correctives that were learned from it."""

import sys
from pathlib import Path

import numpy as np
import pytest

from corporeal.model.files import open_model

ASSETS = Path(__file__).parents[3] / "assets"


@pytest.fixture(scope="module")
def assets():
    """The build scripts' modules, as the scripts see them."""
    sys.path.insert(0, str(ASSETS))
    try:
        from open_hand import finger_bends, soft_correctives, soft_hand

        yield {"bends": finger_bends, "correctives": soft_correctives, "hand": soft_hand}
    finally:
        sys.path.remove(str(ASSETS))


@pytest.fixture(scope="module")
def start():
    return open_model("start_hand")


def test_only_correctives_and_joints_differ_from_the_start_hand(start):
    soft = open_model("soft_hand")
    for name in ("template", "faces", "skinning_weights", "parents", "shape_directions"):
        assert np.array_equal(getattr(soft, name), getattr(start, name)), name
    moved = np.linalg.norm((soft.joint_regressor - start.joint_regressor) @ start.template, axis=1)
    assert moved[0] < 1e-6 and 1e-3 < moved[1:].mean() < 3e-3 and moved.max() < 6e-3
    assert "soft body" in soft.notes["correctives"] and "from 372 scans of 31 hands" in soft.notes["joints"]
    assert not np.array_equal(soft.pose_directions, start.pose_directions)


def test_at_the_zero_pose_nothing_is_strained(assets, start):
    settled = assets["hand"].SoftOpenHand(start, start.template).posed(np.zeros((15, 3)))
    # The axes are made for fingers that are straight; the file's are so within 0.02 degrees.
    assert np.abs(settled.surface - start.template).max() < 5e-5
    assert np.abs(settled.pose).max() < 5e-4 and settled.volume_ratio == pytest.approx(1, abs=1e-6)


def test_angles_turn_the_bones_that_they_name(assets, start):
    angles = np.zeros((15, 3))
    angles[1, 0] = 50.0  # index2, flexion
    pose = assets["hand"].SoftOpenHand(start, start.template).posed(angles).pose
    turned = np.rad2deg(np.linalg.norm(pose, axis=1))
    np.testing.assert_allclose(turned, [0, 0, 50, *13 * [0]], atol=0.03)
    assert pose[2, 2] > 0.8, "a positive turn about +z flexes"


@pytest.mark.slow
def test_correctives_of_the_file_are_near_the_flesh_in_bends_that_they_were_not_learned_from(assets, start):
    bends = assets["bends"].settled_bends(start, (5, 5), seed=321)
    assert bends.volume_ratios.min() > 0.97
    distance = assets["correctives"].distances_to
    plain = start.replace(pose_directions=np.zeros_like(start.pose_directions))
    # Its bones turned about the start hand's joints.
    learned = open_model("soft_hand").replace(joint_regressor=start.joint_regressor)
    without, earlier, soft = (1e3 * distance(model, bends).mean() for model in (plain, start, learned))
    assert earlier < without and soft < 0.4 * earlier and soft < 0.6
