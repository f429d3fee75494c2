"""``corporeal simulate --body``: what lies on the disk, and how a capture goes on."""

import json

import numpy as np
import pytest

from corporeal.cli import simulate, simulate_bodies
from corporeal.cli.commands import Simulate
from corporeal.cli.errors import CommandError
from corporeal.scans.files import read_scan, read_sequence
from corporeal.scans.simulation.bodies.sequences import SequenceOptions, plan_sequences
from corporeal.scans.units import BODY_EXTENT


@pytest.fixture
def made(monkeypatch):
    """What would be made; nothing is."""
    asked = []

    def note(make, pieces, total, workers, console):
        asked.append([(planned.name, frame) for planned, frames in pieces for frame in frames])
        assert total == len(asked[-1])

    monkeypatch.setattr(simulate_bodies, "make_pieces", note)
    return asked


@pytest.mark.slow
def test_a_frame_has_its_truth_beside_it_and_the_same_bytes_again(tmp_path):
    planned = plan_sequences(SequenceOptions(1, 30))[0]
    for folder in ("a", "b"):
        assert simulate_bodies.make_frames(tmp_path / folder, (planned, [7])) == 1
    scan = read_scan(tmp_path / "a" / planned.name / "scans" / "0007.ply", "mm", BODY_EXTENT)
    with np.load(tmp_path / "a" / planned.name / "truth" / "0007.npz", allow_pickle=False) as truth:
        assert truth["template"].shape == (18056, 3)
        low, high = scan.points.min(0) - 0.05, scan.points.max(0) + 0.05
        assert ((truth["template"] > low) & (truth["template"] < high)).all()
        assert truth["missing"].tolist() == list(planned.missing(7))
    for file in ("scans/0007.ply", "truth/0007.npz"):
        first, second = ((tmp_path / folder / planned.name / file).read_bytes() for folder in ("a", "b"))
        assert first == second


def test_the_list_can_be_read_by_track(made, tmp_path):
    result = tmp_path / "r.json"
    call = Simulate(tmp_path / "s", body=True, sequences=2, frames=15, subjects=2, json=result)
    assert simulate.run(call) == 0
    names = json.loads(result.read_text())["sequences"]
    for name in names:
        sequence = read_sequence(tmp_path / "s" / name)
        assert (sequence.name, sequence.fps, sequence.unit, len(sequence.frames)) == (name, 60.0, "mm", 15)
        assert "losses" not in (tmp_path / "s" / name / "sequence.json").read_text()
    assert made[0] == [(name, frame) for name in names for frame in range(15)]


def test_what_is_there_is_not_made_again_and_more_sequences_can_be_added(made, tmp_path):
    simulate.run(Simulate(tmp_path, body=True, sequences=1, frames=15, subjects=2))
    name, frame = made[0][3]
    (tmp_path / name / "truth" / f"{frame:04d}.npz").write_bytes(b"done")
    simulate.run(Simulate(tmp_path, body=True, sequences=2, frames=15, subjects=2))
    assert made[1][:14] == made[0][:3] + made[0][4:]
    assert len(made[1]) == 29


def test_other_options_do_not_continue_a_capture(made, tmp_path):
    simulate.run(Simulate(tmp_path, body=True, frames=15))
    with pytest.raises(CommandError, match="--frames 15"):
        simulate.run(Simulate(tmp_path, body=True, frames=20))


@pytest.mark.parametrize(
    ("call", "named"),
    [
        ({"body": True, "poses": 3}, "--poses"),
        ({"body": True, "frames": 0}, "--frames"),
        ({"body": True, "seed": -1}, "--seed"),
        ({"frames": 30}, "--frames"),
        ({"subjects": 0}, "--subjects"),
    ],
)
def test_calls_that_make_no_sense_name_the_option(made, tmp_path, call, named):
    with pytest.raises(CommandError, match=named):
        simulate.run(Simulate(tmp_path, **call))
    assert made == []
