"""A learned model and its companion on disk."""

import io

import numpy as np
import pytest

from corporeal.learning.files import LearnedFileError, companion_path, load_learned, save_learned
from corporeal.learning.learn import learn_model
from corporeal.learning.options import LearningOptions


@pytest.fixture(scope="module")
def learned(make_tube):
    tube = make_tube(people=3, count=4)
    return learn_model(tube.training, tube.start, LearningOptions(sweeps=1))


def test_everything_comes_back(learned, tmp_path):
    path = tmp_path / "arm.npz"
    save_learned(learned, path)
    assert companion_path(path) == tmp_path / "arm.learning.npz"
    again = load_learned(path)
    for name in ("hands", "subjects", "names", "left_out", "log", "options"):
        assert getattr(again, name) == getattr(learned, name), name
    for name in ("joints", "poses", "translations", "rms_mm", "shape_variances", "pose_variances"):
        assert np.array_equal(getattr(again, name), getattr(learned, name)), name
    assert np.abs(again.templates - learned.templates).max() < 1e-7
    for name in ("template", "shape_directions", "pose_directions", "skinning_weights"):
        difference = np.abs(getattr(again.model, name) - getattr(learned.model, name))
        assert difference.max() < 1e-6, name
    assert np.array_equal(again.model.faces, learned.model.faces)


def test_the_same_model_gives_the_same_bytes(learned, tmp_path):
    for name in ("one.npz", "two.npz"):
        save_learned(learned, tmp_path / name)
    assert (tmp_path / "one.npz").read_bytes() == (tmp_path / "two.npz").read_bytes()


def test_what_is_wrong_with_the_companion_is_said(learned, tmp_path):
    path = tmp_path / "arm.npz"
    save_learned(learned, path)
    content = companion_path(path).read_bytes()
    companion_path(path).write_bytes(content[: len(content) // 2])
    with pytest.raises(LearnedFileError, match=r"arm\.learning\.npz: damaged"):
        load_learned(path)
    with np.load(io.BytesIO(content)) as archive:
        earlier = {name: archive[name] for name in archive.files if name != "options"}
    np.savez(companion_path(path), **earlier)
    with pytest.raises(LearnedFileError, match=r"holds no 'options': written by an earlier version"):
        load_learned(path)
    companion_path(path).unlink()
    with pytest.raises(LearnedFileError, match=r"arm\.learning\.npz: missing"):
        load_learned(path)
