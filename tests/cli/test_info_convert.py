"""``corporeal info`` and ``corporeal convert`` on files of every layout."""

import importlib.util
import json
import sys
from pathlib import Path

import numpy as np
import pytest

from corporeal.cli.main import main
from corporeal.model.files import load_model, open_model, save_model
from corporeal.model.mirror import mirror_model


@pytest.fixture(scope="module")
def official():
    path = Path(__file__).resolve().parents[1] / "model" / "official_layouts.py"
    spec = importlib.util.spec_from_file_location("official_layouts_for_commands", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(
    ("name", "title", "joints"),
    [
        ("mano", "MANO", 16),
        ("smpl", "SMPL", 24),
        ("smplh", "SMPL+H", 52),
        ("smplx", "SMPL-X", 55),
        ("flame", "FLAME", 5),
    ],
)
def test_info_counts_what_a_file_holds(official, name, title, joints, tmp_path, rng, capsys):
    path = official.write_chumpy_pickle(tmp_path / "a.pkl", official.official_arrays(name, rng))
    assert main(["info", str(path), "--json", str(tmp_path / "a.json")]) == 0
    content = json.loads((tmp_path / "a.json").read_text())
    assert (content["kind"], content["family"], content["joints"]) == ("model", title, joints)
    assert (content["vertices"], content["faces"], content["shape"]) == (60, 90, 10)
    assert content["expression"] == (10 if name in ("smplx", "flame") else 0)
    assert content["correctives"] == 9 * (joints - 1)
    assert sum(block["joints"] for block in content["blocks"]) == joints - 1
    printed = capsys.readouterr()
    assert title in printed.out
    assert printed.err == ""


def test_info_counts_the_points_of_a_scan(tmp_path, rng, capsys):
    corners = 0.1 * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.5]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    lines = [f"v {x} {y} {z}" for x, y, z in corners] + [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces]
    path = tmp_path / "scan.obj"
    path.write_text("\n".join(lines) + "\n")
    assert main(["info", str(path), "--json", str(tmp_path / "a.json")]) == 0
    content = json.loads((tmp_path / "a.json").read_text())
    assert (content["kind"], content["points"], content["faces"]) == ("scan", 4, 4)
    assert "scan" in capsys.readouterr().out


@pytest.mark.parametrize("name", ["missing.npz", "damaged.pkl", "noodles", "missing.ply"])
def test_info_says_in_one_line_why_it_cannot(name, tmp_path, capsys):
    (tmp_path / "damaged.pkl").write_bytes(b"cposix\nsystem\n(S'true'\ntR.")
    assert main(["info", str(tmp_path / name)]) == 1
    printed = capsys.readouterr()
    assert printed.out == ""
    assert len(printed.err.strip().splitlines()) == 1
    assert name.split(".")[0] in printed.err


def test_convert_there_and_back_keeps_the_model(official, tmp_path, rng, capsys):
    source = official.write_chumpy_pickle(tmp_path / "a.pkl", official.official_arrays("smplx", rng))
    ours, theirs = tmp_path / "new" / "ours.npz", tmp_path / "theirs.pkl"
    assert main(["convert", str(source), str(ours), "--json", str(tmp_path / "a.json")]) == 0
    assert main(["convert", str(ours), str(theirs), "--layout", "official"]) == 0
    first, last = load_model(source), load_model(theirs)
    np.testing.assert_array_equal(first.shape_directions, last.shape_directions)
    np.testing.assert_array_equal(first.expression_directions, last.expression_directions)
    np.testing.assert_array_equal(first.pose_directions, last.pose_directions)
    content = json.loads((tmp_path / "a.json").read_text())
    assert content["model"]["family"] == "SMPL-X"
    assert content["warnings"] == []
    assert len(capsys.readouterr().err.strip().splitlines()) == 2


def test_convert_repairs_a_left_hand_on_request(official, tmp_path, rng, capsys):
    right = official.write_npz(tmp_path / "right.npz", official.official_arrays("mano", rng))
    sound = mirror_model(load_model(right))
    faulty = sound.replace(shape_directions=sound.shape_directions * [[[-1.0], [1], [1]]])
    left, target = tmp_path / "left.npz", tmp_path / "out.npz"
    save_model(faulty, left, layout="official")
    assert main(["convert", str(left), str(target)]) == 0
    assert "--right MANO_RIGHT.pkl" in capsys.readouterr().err
    assert main(["convert", str(left), str(target), "--right", str(right)]) == 0
    assert "not mirrored" in capsys.readouterr().err
    assert main(["convert", str(left), str(target), "--right", str(right), "--repair-left"]) == 0
    assert "mirrored" not in capsys.readouterr().err
    np.testing.assert_array_equal(load_model(target).shape_directions, sound.shape_directions)


@pytest.mark.parametrize(
    ("arguments", "status", "message"),
    [
        (["{right}", "{folder}/out.obj"], 2, "ends in .npz or .pkl"),
        (["{right}", "{right}"], 2, "is the source itself"),
        (["{right}", "{folder}/out.npz", "--repair-left"], 2, "--right"),
        (["{folder}/none.pkl", "{folder}/out.npz"], 1, "cannot be read"),
        (["{right}", "{folder}/out.npz", "--right", "{right}"], 1, "sides are right and right"),
    ],
)
def test_convert_says_in_one_line_why_it_cannot(official, arguments, status, message, tmp_path, rng, capsys):
    right = official.write_npz(tmp_path / "right.npz", official.official_arrays("mano", rng))
    before = right.read_bytes()
    filled = [argument.format(right=right, folder=tmp_path) for argument in arguments]
    assert main(["convert", *filled]) == status
    printed = capsys.readouterr().err
    assert message in printed
    assert len(printed.strip().splitlines()) == 1
    assert right.read_bytes() == before
    assert not list(tmp_path.glob("out*"))


@pytest.mark.parametrize("command", ["info", "convert"])
@pytest.mark.parametrize("name", ["notes.pkl", "notes.npz", "notes", "notes.txt", "folder", "folder.npz"])
def test_what_is_no_model_is_told_what_was_expected(command, name, tmp_path, capsys):
    path = tmp_path / name
    if name.startswith("folder"):
        path.mkdir()
    else:
        path.write_text("dear diary")
    arguments = [str(path)] + ([str(tmp_path / "out.npz")] if command == "convert" else [])
    assert main([command, *arguments]) == 1
    printed = capsys.readouterr().err
    assert "expected .npz or .pkl" in printed and name in printed
    assert "pickle" not in printed and len(printed.strip().splitlines()) == 1


def test_convert_takes_the_open_model_by_name(tmp_path):
    target = tmp_path / "out.npz"
    assert main(["convert", "hand", str(target)]) == 0
    np.testing.assert_array_equal(load_model(target).template, open_model("hand").template)
