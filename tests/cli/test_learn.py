"""``corporeal learn``: what it reads, what it writes, and what it refuses."""

import dataclasses
import json
from functools import partial
from importlib import import_module

import numpy as np
import pytest
from PIL import Image

from corporeal.cli.main import main
from corporeal.learning.files import load_learned
from corporeal.learning.options import LearningOptions
from corporeal.learning.training_set import LearningError
from corporeal.model.files import load_model, open_model, save_model

_SMALL = ["--no-correctives"]


@pytest.fixture(scope="module", autouse=True)
def _quick():
    """How well it learns is tested in its own room."""
    with pytest.MonkeyPatch.context() as patch:
        quick = partial(LearningOptions, sweeps=1)
        patch.setattr(import_module("corporeal.cli.learn"), "LearningOptions", quick)
        yield


@pytest.fixture(scope="module")
def records(made_records):
    return made_records(open_model("hand"), people=4, poses=4)


@pytest.fixture(scope="module")
def registrations(records, write_registrations, tmp_path_factory):
    return write_registrations(tmp_path_factory.mktemp("reg") / "made", records)


@pytest.fixture(scope="module")
def learned(registrations, tmp_path_factory):
    """Learned with everything on; nobody writes into this folder again."""
    folder = tmp_path_factory.mktemp("learned")
    arguments = ["learn", str(registrations), "-o", str(folder / "m.npz"), "--json", str(folder / "m.json")]
    assert main([*arguments, "--name", "mine", "--pictures"]) == 0
    return folder


def _learn(folder, output, *options):
    return main(["learn", str(folder), "-o", str(output), *options])


@pytest.mark.slow
def test_the_model_explains_its_registrations_and_says_where_it_comes_from(learned, registrations):
    result = json.loads((learned / "m.json").read_text())
    assert (result["registrations"], result["hands"], result["subjects"]) == (20, 5, 4)
    assert result["left_out"] == [] and result["rms_mm"] < 0.8 * result["log"][0]["rms_mm"]
    assert result["log"][-1]["rms_mm"] == result["rms_mm"]
    model = load_model(learned / "m.npz")
    assert model.name == "mine" and model.has_correctives and model.side == "right"
    assert "20 registrations of 5 hands of 4 people" in model.notes["learned"]
    assert model.notes["learned from"] == registrations.name
    kept = load_learned(learned / "m.npz")
    assert kept.hands == ("s00/left", "s00/right", "s01/right", "s02/right", "s03/right")


@pytest.mark.slow
def test_a_left_hand_was_mirrored_in(learned):
    kept = load_learned(learned / "m.npz")
    left, right = kept.templates[:2]
    left, right = left - left.mean(axis=0), right - right.mean(axis=0)
    another = kept.templates[2] - kept.templates[2].mean(axis=0)
    assert np.abs(left - right).max() < 0.25 * np.abs(another - right).max()


@pytest.mark.slow
def test_pictures_and_glb_lie_beside_the_model(learned):
    assert {path.name for path in learned.iterdir()} == {
        "m.npz", "m.learning.npz", "m.json", "m.shape.png", "m.pose.png", "m.glb",
    }  # fmt: skip
    for name in ("m.shape.png", "m.pose.png"):
        with Image.open(learned / name) as picture:
            assert min(picture.size) > 400 and len(np.unique(np.asarray(picture)[..., 0])) > 50
    assert b"shape_00" in (learned / "m.glb").read_bytes()


@pytest.mark.slow
def test_without_correctives_and_with_the_right_hands_alone(registrations, tmp_path):
    output, result = tmp_path / "m.npz", tmp_path / "m.json"
    assert _learn(registrations, output, *_SMALL, "--sides", "right-only", "--json", str(result)) == 0
    assert json.loads(result.read_text())["hands"] == 4
    model = load_model(output)
    assert not model.has_correctives and model.notes["correctives"] == "none"
    assert model.name == open_model("hand").name


@pytest.mark.slow
def test_the_same_call_gives_the_same_bytes(registrations, tmp_path):
    for name in ("a", "b"):
        assert _learn(registrations, tmp_path / f"{name}.npz", *_SMALL, "--seed", "3") == 0
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


@pytest.mark.slow
def test_what_the_curator_says_counts_more_than_the_status(records, tmp_path, write_registrations, decide):
    doubtful = [
        dataclasses.replace(record, row=record.row | {"status": "doubtful"}) if number < 2 else record
        for number, record in enumerate(records)
    ]
    folder, result = write_registrations(tmp_path / "reg", doubtful), tmp_path / "m.json"
    decide(folder, {records[0].name: "accept", records[-1].name: "reject"})
    assert _learn(folder, tmp_path / "m.npz", *_SMALL, "--json", str(result)) == 0
    assert set(load_learned(tmp_path / "m.npz").names) == {
        record.name for record in records if record.name not in (records[1].name, records[-1].name)
    }


@pytest.mark.slow
def test_it_survives_that_half_is_rejected(
    records, registrations, learned, tmp_path, write_registrations, decide
):
    folder = write_registrations(tmp_path / "reg", records)
    decide(folder, {record.name: "reject" for record in records[::2]})
    assert _learn(folder, tmp_path / "m.npz", *_SMALL) == 0
    half, whole = load_learned(tmp_path / "m.npz"), load_learned(learned / "m.npz")
    assert set(half.names) == {record.name for record in records[1::2]}
    assert half.rms_mm.mean() < 3 * whole.rms_mm.mean()


def test_a_session_registered_with_another_model_needs_it_as_start(registrations, tmp_path, capsys):
    hand = open_model("hand")
    other = tmp_path / "other.npz"
    save_model(hand.replace(template=1.01 * hand.template), other)
    assert _learn(registrations, tmp_path / "m.npz", "--start", str(other)) == 2
    said = capsys.readouterr().err
    assert "was registered with another model" in said and "--start" in said
    assert not (tmp_path / "m.npz").exists()


@pytest.mark.slow
def test_a_number_that_is_not_finite_is_named(records, tmp_path, capsys, write_registrations, decide):
    vertices = records[6].vertices.copy()
    translation = records[6].translation.copy()
    translation[1] = np.nan
    spoilt = dataclasses.replace(records[6], vertices=vertices, translation=translation)
    folder = write_registrations(tmp_path / "reg", [*records[:6], spoilt, *records[7:]])
    assert _learn(folder, tmp_path / "m.npz") == 2
    said = capsys.readouterr().err
    assert records[6].name in said and "not finite" in said and "reject it" in said
    decide(folder, {records[6].name: "reject"})
    assert _learn(folder, tmp_path / "m.npz", *_SMALL) == 0


def test_no_folder_and_a_start_that_is_not_there_are_refused(registrations, tmp_path, capsys):
    for start in ([], ["--start", "hand"]):
        assert main(["learn", "-o", str(tmp_path / "m.npz"), *start]) == 2
        assert "give at least one folder" in capsys.readouterr().err
    assert _learn(registrations, tmp_path / "m.npz", "--start", "nobody") == 2
    assert "--start nobody: no model of that name" in " ".join(capsys.readouterr().err.split())


def test_too_few_people_are_too_few(records, tmp_path, capsys, write_registrations):
    folder = write_registrations(tmp_path / "reg", [r for r in records if r.row["subject"] < "s02"])
    assert _learn(folder, tmp_path / "m.npz") == 1
    assert "registrations of 2 people; at least 3 are needed" in capsys.readouterr().err
    assert not (tmp_path / "m.npz").exists()


def test_nothing_accepted_is_said(records, tmp_path, capsys, write_registrations, decide):
    folder = write_registrations(tmp_path / "reg", records[:3])
    decide(folder, {record.name: "reject" for record in records[:3]})
    assert _learn(folder, tmp_path / "m.npz") == 2
    assert "none of 3 registrations is accepted" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "changed"),
    [
        ([], {}),
        (["--corrective-strength", "0.8"], {"corrective_strength": 0.8}),
        (["--no-hinges"], {"hinge_strength": 0.0}),
        (["--start-shape-weight", "1"], {"start_shape_weight": 1.0}),
    ],
)
def test_what_is_asked_for_is_what_is_learned_with(registrations, tmp_path, monkeypatch, arguments, changed):
    found = []

    def stop(training, start, options, on_step):
        found.append(options)
        raise LearningError("seen")

    monkeypatch.setattr(import_module("corporeal.cli.learn"), "learn_model", stop)
    assert _learn(registrations, tmp_path / "m.npz", *arguments) == 1
    assert found == [LearningOptions(sweeps=1, **changed)]


@pytest.mark.parametrize("number", ["0", "-1", "nan", "inf"])
def test_a_strength_that_is_none_is_refused(registrations, tmp_path, capsys, number):
    assert _learn(registrations, tmp_path / "m.npz", "--corrective-strength", number) == 2
    assert "expected more than 0" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("output", "words"),
    [("m.pkl", "ends in .npz"), ("folder.npz", "is a folder"), ("file/m.npz", "is a file")],
)
def test_an_output_that_cannot_be_is_refused_first(registrations, tmp_path, capsys, output, words):
    (tmp_path / "folder.npz").mkdir()
    (tmp_path / "file").write_text("")
    assert _learn(registrations, tmp_path / output) == 2
    assert words in capsys.readouterr().err


def test_a_folder_without_registrations_is_named(tmp_path, capsys):
    assert _learn(tmp_path, tmp_path / "m.npz") == 2
    assert f"{tmp_path}: holds no records" in capsys.readouterr().err
