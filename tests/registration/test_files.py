import numpy as np
import pytest

from corporeal.registration.files import RegistrationFileError, load_registration, save_registration
from corporeal.registration.register import register


@pytest.fixture(scope="module")
def saved(hand, make_capture, tmp_path_factory):
    capture = make_capture(hand, 21)
    result = register(capture.scan, hand, capture.evidence)
    path = tmp_path_factory.mktemp("saved") / "registration.npz"
    save_registration(result, path)
    return result, path


def test_a_registration_comes_back_to_the_bit(saved):
    result, path = saved
    again = load_registration(path)
    for name in ("vertices", "model_vertices"):
        np.testing.assert_array_equal(getattr(again, name), getattr(result, name))
    np.testing.assert_array_equal(again.faces, result.model.faces)
    np.testing.assert_array_equal(again.parameters.vector(), result.parameters.vector())
    assert again.landmarks.keys() == result.landmarks.keys()
    for name, point in result.landmarks.items():
        np.testing.assert_array_equal(again.landmarks[name], point)
    assert (again.side, again.status, again.reason) == (result.side, result.status, result.reason)
    assert (again.model, again.correctives) == (result.model.name, True)
    assert again.unit == result.scan.unit


@pytest.mark.parametrize(
    "change",
    [
        {"pose": None},
        {"status": np.array("splendid")},
        {"unit": np.array("feet")},
        {"model_vertices": np.zeros((5, 3))},
        {"faces": np.full((1, 3), 10**6)},
        {"translation": np.array([None], dtype=object)},
    ],
)
def test_other_archives_are_refused_by_name(saved, tmp_path, change):
    with np.load(saved[1]) as archive:
        arrays = {name: archive[name] for name in archive.files}
    kept = {name: value for name, value in (arrays | change).items() if value is not None}
    np.savez(tmp_path / "other.npz", **kept)
    with pytest.raises(RegistrationFileError, match=r"other\.npz"):
        load_registration(tmp_path / "other.npz")


def test_a_cut_off_file_is_refused_and_an_absent_one_is_absent(saved, tmp_path):
    (tmp_path / "half.npz").write_bytes(saved[1].read_bytes()[:5000])
    with pytest.raises(RegistrationFileError, match=r"half\.npz"):
        load_registration(tmp_path / "half.npz")
    with pytest.raises(FileNotFoundError):
        load_registration(tmp_path / "none.npz")
