"""Files in the layout of AMASS, read back by a script that knows only that layout, and posed by smplx."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from corporeal.export.amass import Motion, amass_arrays, write_amass

SCRIPT = Path(__file__).with_name("read_amass.py")


def motion(rng, frames=7, joints=55):
    poses = 0.3 * rng.standard_normal((frames, joints, 3))
    return Motion(poses, rng.standard_normal((frames, 3)), rng.standard_normal(24), 60.0, "female")


@pytest.mark.parametrize(("joints", "kind"), [(55, "smplx"), (52, "smplh")])
def test_a_script_that_knows_only_the_layout_reads_it(rng, tmp_path, joints, kind):
    given = motion(rng, joints=joints)
    write_amass(tmp_path / "track.npz", given, {"frame_names": np.array(list("abcdefg"))})
    command = [sys.executable, str(SCRIPT), str(tmp_path / "track.npz")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)
    assert (said["gender"], said["type"]) == ("female", kind)
    assert said["seconds"] == pytest.approx(7 / 60)
    steps = np.linalg.norm(np.diff(given.translations, axis=0), axis=1)
    assert said["walked_m"] == pytest.approx(steps.sum(), rel=1e-12)
    fingers = np.linalg.norm(given.poses[:, -30:], axis=2).mean(axis=1)
    np.testing.assert_allclose(said["finger_radians"], fingers, rtol=1e-12)


def test_the_script_sees_a_part_that_does_not_belong_to_its_poses(rng, tmp_path):
    arrays = amass_arrays(motion(rng))
    arrays["pose_jaw"] = arrays["pose_jaw"] + 1e-9
    np.savez(tmp_path / "wrong.npz", **arrays)
    command = [sys.executable, str(SCRIPT), str(tmp_path / "wrong.npz")]
    assert subprocess.run(command, capture_output=True, check=False).returncode != 0


def test_old_and_new_keys_agree_and_the_parts_make_the_whole(rng):
    arrays = amass_arrays(motion(rng))
    assert arrays["poses"].shape == (7, 165)
    order = ("root_orient", "pose_body", "pose_jaw", "pose_eye", "pose_hand")
    np.testing.assert_array_equal(np.concatenate([arrays[key] for key in order], axis=1), arrays["poses"])
    assert arrays["mocap_framerate"] == arrays["mocap_frame_rate"] == 60
    assert arrays["num_betas"] == len(arrays["betas"]) == 24
    other = amass_arrays(motion(rng, joints=5))
    assert other["surface_model_type"] == "other" and "pose_body" not in other


def test_equal_motions_give_equal_bytes(rng, tmp_path):
    given = motion(rng)
    for name in ("a", "b"):
        write_amass(tmp_path / name / "track.npz", given)
    contents = [(tmp_path / name / "track.npz").read_bytes() for name in ("a", "b")]
    assert contents[0] == contents[1]


def test_wrong_motions_are_refused_and_leave_nothing(rng, tmp_path):
    good = motion(rng)
    for wrong, words in (
        (replace(good, translations=good.translations[1:]), "translations: 6 for 7 frames"),
        (replace(good, poses=good.poses * np.nan), "poses: holds NaN"),
        (replace(good, fps=0.0), "fps: expected a positive number"),
    ):
        with pytest.raises(ValueError, match=words):
            write_amass(tmp_path / "track.npz", wrong)
    with pytest.raises(ValueError, match="'trans' is a key of AMASS"):
        write_amass(tmp_path / "track.npz", good, {"trans": np.zeros(3)})
    assert not list(tmp_path.iterdir())
