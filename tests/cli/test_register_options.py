"""What each option of the register command hands on, and what is refused before any fit."""

import json
import os
from importlib import import_module

import numpy as np
import pytest
import trimesh

from corporeal.cli import files
from corporeal.cli.main import main
from corporeal.model.files import open_model
from corporeal.registration.evidence import LandmarkFinder
from corporeal.registration.registration import FailedRegistration


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    """The open hand's template in millimetres; every face of the lower half of the list is green."""
    folder = tmp_path_factory.mktemp("capture")
    hand = open_model("hand")
    colours = np.full((hand.vertex_count, 4), 200, np.uint8)
    colours[hand.template[:, 0] > np.median(hand.template[:, 0])] = (10, 240, 10, 255)
    mesh = trimesh.Trimesh(1e3 * hand.template, hand.faces, vertex_colors=colours, process=False)
    mesh.export(folder / "scan[bold].ply")
    return folder / "scan[bold].ply"


@pytest.fixture
def fits(monkeypatch):
    """What the command hands to the fit, which says no at once."""
    calls = []

    def fake(scan, model, evidence, side, options, *_):
        calls.append((scan, side, options))
        return FailedRegistration(scan, "not fitted [here]")

    class Finder(LandmarkFinder):
        def __init__(self, *_):
            pass

        def __enter__(self):
            return self

        def __exit__(self, *_):
            pass

        def find(self, _):
            return None, []

    module = import_module("corporeal.cli.register")
    monkeypatch.setattr(module, "register", fake)
    monkeypatch.setattr(module, "LandmarkFinder", Finder)
    return calls


def _row(capture, tmp_path, *arguments):
    result = tmp_path / "row.json"
    main(["register", str(capture), "-o", str(tmp_path / "out"), "--json", str(result), *arguments])
    return json.loads(result.read_text())["items"][0]


def test_a_wrong_unit_fails_before_any_fit(capture, tmp_path, fits):
    row = _row(capture, tmp_path, "--unit", "cm")
    assert row["status"] == "failed" and "--unit mm" in row["reason"] and "diagonal" in row["reason"]
    assert not fits


def test_free_and_correctives_and_side_are_handed_on(capture, tmp_path, fits):
    _row(capture, tmp_path, "--unit", "free", "--no-correctives", "--side", "left")
    _row(capture, tmp_path)
    (free, side, options), (guessed, no_side, defaults) = fits
    assert free.unit.name == "free" and guessed.unit.name == "mm"
    assert (side, no_side) == ("left", None)
    assert (options.correctives, defaults.correctives) == (False, True)


def test_green_objects_are_dropped_when_asked(capture, tmp_path, fits):
    _row(capture, tmp_path)
    _row(capture, tmp_path, "--green-objects")
    whole, rest = fits[0][0], fits[1][0]
    assert 0.3 * len(whole.points) < len(rest.points) < 0.7 * len(whole.points)
    assert (rest.colours[:, 1] <= 200).all()


def test_names_with_brackets_are_printed_whole_on_one_line(capture, tmp_path, fits, capsys):
    _row(capture, tmp_path)
    (line,) = [line for line in capsys.readouterr().err.splitlines() if "failed" in line]
    assert line == f"{capture}: failed - not fitted [here]"


def test_unknown_landmark_names_are_refused(capture, tmp_path, capsys):
    marks = tmp_path / "marks.json"
    marks.write_text(json.dumps({"elbow": [0, 0, 0]}))
    assert main(["register", str(capture), "-o", str(tmp_path / "out"), "--landmarks", str(marks)]) == 2
    assert "elbow" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("option", ["-o", "--json"])
@pytest.mark.parametrize("below", ["", "deeper"])
def test_a_file_in_the_way_exits_with_two_before_any_fit(capture, tmp_path, fits, capsys, option, below):
    (tmp_path / "block").write_text("mine")
    blocked = tmp_path / "block" / below if below else tmp_path / "block"
    if option == "--json" and not below:
        blocked = tmp_path
    arguments = {"-o": tmp_path / "out", option: blocked}
    words = [str(word) for pair in arguments.items() for word in pair]
    assert main(["register", str(capture), *words]) == 2
    printed = capsys.readouterr().err
    assert option in printed and str(blocked) in printed
    assert not fits and (tmp_path / "block").read_text() == "mine"
    assert not (tmp_path / "out").exists()


def test_a_file_named_like_the_scans_folder_is_in_the_way_too(capture, tmp_path, fits):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / capture.stem).write_text("")
    assert main(["register", str(capture), "-o", str(tmp_path / "out")]) == 2
    assert not fits


def test_a_scan_that_is_not_there_leaves_no_folder(tmp_path, fits):
    row = _row(tmp_path / "none.ply", tmp_path)
    assert row["status"] == "failed" and "none.ply" in row["reason"]
    assert not (tmp_path / "out").exists()


def test_a_model_that_is_none_is_refused(capture, tmp_path, capsys):
    (tmp_path / "notes.txt").write_text("dear diary")
    for name in (tmp_path / "notes.txt", tmp_path):
        assert main(["register", str(capture), "-o", str(tmp_path / "out"), "--model", str(name)]) == 2
        printed = capsys.readouterr().err
        assert "expected .npz or .pkl" in printed and "pickle" not in printed


def test_the_first_compilation_is_announced(capture, tmp_path, fits, capsys, monkeypatch):
    cache = tmp_path / "cache"
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(cache))
    _row(capture, tmp_path)
    assert capsys.readouterr().err.count("compiles kernels") == 1
    (cache / "some_hash").mkdir(parents=True)
    indices = [cache / "some_hash" / f"{name.split('/')[1][:-3]}.f-1.py311.nbi" for name in files._KERNELS]
    for index in indices:
        index.touch()
    _row(capture, tmp_path)
    assert "compiles" not in capsys.readouterr().err
    os.utime(indices[0], (0, 0))
    assert not files.kernels_are_compiled()
