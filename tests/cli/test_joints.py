"""``corporeal joints``: what it reads, what it writes, and what it refuses."""

import dataclasses
import json
import shutil

import numpy as np
import pytest

from corporeal.cli.joints import evenly_bent
from corporeal.cli.main import main
from corporeal.export.meshes import write_ply
from corporeal.learning.training_set import training_set
from corporeal.model.files import load_model, open_model

_SCANS = ["--scans", "2"]


@pytest.fixture(scope="module")
def records(made_records, tmp_path_factory):
    """Two people's hands whose registrations are what was scanned."""
    folder, hand, records = tmp_path_factory.mktemp("scanned"), open_model("start_hand"), []
    for record in made_records(hand, people=2, poses=3, seed=9):
        path = folder / f"{record.name}.ply"
        write_ply(path, 1e3 * record.vertices, hand.faces)
        records.append(dataclasses.replace(record, row=record.row | {"scan": str(path), "unit": "mm"}))
    return records


@pytest.fixture(scope="module")
def registered(records, write_registrations, tmp_path_factory):
    return write_registrations(tmp_path_factory.mktemp("joints") / "reg", records, open_model("start_hand"))


def _joints(folder, output, *options):
    return main(["joints", str(folder), "-o", str(output), *_SCANS, *options])


def test_the_model_is_the_start_with_other_joints(registered, tmp_path, capsys):
    out = tmp_path / "placed.npz"
    assert _joints(registered, out, "--name", "mine", "--json", str(tmp_path / "it.json")) == 0
    start, placed = open_model("start_hand"), load_model(out)
    result = json.loads((tmp_path / "it.json").read_text())
    shifts = np.array([result["shifts_mm"][name] for name in start.joint_names])
    moved = 1e3 * (placed.joint_regressor @ start.template - start.joint_regressor @ start.template)
    np.testing.assert_allclose(moved, shifts, atol=0.5)
    assert np.abs(shifts[0]).max() == 0 and np.abs(shifts).max() < 3, "the scans are the start's own"
    assert result["rms_mm"][-1] < 0.4 and len(result["scans"]) == 4
    assert all(name.endswith("_right") for name in result["scans"])
    assert placed.name == "mine" and placed.notes["joints"].endswith("joints, from 4 scans of 2 hands")
    np.testing.assert_array_equal(placed.template, start.template)
    assert "joints moved by" in capsys.readouterr().err
    assert _joints(registered, tmp_path / "again.npz", "--name", "mine") == 0
    assert (tmp_path / "again.npz").read_bytes() == out.read_bytes()


def test_scans_are_taken_evenly_from_the_most_bent_to_the_least(records):
    registrations = training_set(records, open_model("start_hand"))
    bends = dict(zip(registrations.names, np.abs(registrations.poses[:, 1:]).sum(axis=(1, 2)), strict=True))
    chosen = evenly_bent(registrations, 2)
    assert len(chosen) == 6
    for hand in sorted(set(chosen.hands)):
        names = [name for name, whose in zip(chosen.names, chosen.hands, strict=True) if whose == hand]
        person, side = hand.split("/")
        all_bends = [bend for name, bend in bends.items() if name[:3] == person and name.endswith(side)]
        assert [bends[name] for name in names] == [max(all_bends), min(all_bends)]
    assert len(evenly_bent(registrations, 50)) == len(registrations)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--scans", "0"], "--scans 0: at least one is needed"),
        (["-o", "placed.pkl"], "name a file that ends in .npz"),
        (["--start", "nobody"], "--start "),
        (["--start", "body"], "none of 0 registrations is accepted"),
    ],
)
def test_wrong_calls_are_refused(registered, tmp_path, capsys, options, said):
    assert _joints(registered, tmp_path / "m.npz", *options) == 2
    assert said in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "m.npz").exists()


def test_a_missing_scan_is_named(records, write_registrations, tmp_path, capsys):
    folder = write_registrations(tmp_path / "reg", records, open_model("start_hand"))
    gone = tmp_path / "scans"
    moved = [
        dataclasses.replace(record, row=record.row | {"scan": str(gone / f"{record.name}.ply")})
        for record in records
    ]
    shutil.rmtree(folder)
    write_registrations(folder, moved, open_model("start_hand"))
    assert _joints(folder, tmp_path / "m.npz") == 1
    assert "is missing" in capsys.readouterr().err
