"""``corporeal simulate``: what lies on the disk, and how a session goes on."""

import json

import numpy as np
import pytest

from corporeal.cli import simulate
from corporeal.cli.commands import Simulate
from corporeal.cli.errors import CommandError
from corporeal.scans.files import ScanFileError, read_scan
from corporeal.scans.formats.session import read_session
from corporeal.scans.simulation.protocol import protocol_poses
from corporeal.scans.simulation.simulate import PlannedScan, SimulationOptions, plan_session

pytestmark = pytest.mark.slow
OPTIONS = SimulationOptions(subjects=1, seed=5)


@pytest.fixture
def made(monkeypatch):
    """What would be made; nothing is."""
    asked = []

    def note(config, options, missing, console):
        asked.append([scan.name for scan in missing])

    monkeypatch.setattr(simulate, "_make_all", note)
    return asked


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Three scans of one hand, two of them spoilt."""
    folder = tmp_path_factory.mktemp("session")
    poses = protocol_poses()
    scans = [
        PlannedScan(f"s01_p{number + 1:02d}_left", 0, "left", poses[number].name, fault)
        for number, fault in ((0, ""), (1, "nan"), (6, "truncated"))
    ]
    assert simulate.make_scans(folder, OPTIONS, scans) == 3
    return folder


def test_a_scan_has_its_truth_beside_it(folder):
    scan = read_scan(folder / "scans" / "s01_p01_left.ply", unit="mm")
    assert 38_000 < len(scan.points) < 62_000
    assert scan.colours is not None
    with np.load(folder / "truth" / "s01_p01_left.npz", allow_pickle=False) as truth:
        assert truth["template"].shape == (2931, 3)
        assert truth["joints"].shape == (16, 3)
        low, high = scan.points.min(0) - 0.02, scan.points.max(0) + 0.02
        assert ((truth["template"] > low) & (truth["template"] < high)).all()
        assert str(truth["fault"]) == ""


@pytest.mark.parametrize("name", ["s01_p02_left", "s01_p07_left"])
def test_bad_scans_are_refused_by_the_reader_and_have_a_truth(folder, name):
    with pytest.raises(ScanFileError):
        read_scan(folder / "scans" / f"{name}.ply", unit="mm")
    with np.load(folder / "truth" / f"{name}.npz", allow_pickle=False) as truth:
        assert str(truth["fault"]) in ("nan", "truncated")


def test_the_same_seed_gives_the_same_bytes(folder, tmp_path):
    again = [PlannedScan("s01_p01_left", 0, "left", protocol_poses()[0].name, "")]
    simulate.make_scans(tmp_path, OPTIONS, again)
    for file in ("scans/s01_p01_left.ply", "truth/s01_p01_left.npz"):
        assert (tmp_path / file).read_bytes() == (folder / file).read_bytes()


def test_the_list_can_be_read_by_register(made, tmp_path):
    assert simulate.run(Simulate(tmp_path / "s", subjects=1, poses=8)) == 0
    session = read_session(tmp_path / "s", (".ply",))
    plan = plan_session(SimulationOptions(subjects=1, poses=8))
    assert [scan.name for scan in session.scans] == sorted(scan.name for scan in plan)
    assert made == [[scan.name for scan in plan]]
    assert session.unit == "mm"


def test_what_is_there_is_not_made_again(made, tmp_path):
    simulate.run(Simulate(tmp_path, subjects=1, poses=8))
    (tmp_path / "truth" / f"{made[0][3]}.npz").write_bytes(b"done")
    simulate.run(Simulate(tmp_path, subjects=1, poses=8, json=tmp_path / "r.json"))
    assert made[1] == made[0][:3] + made[0][4:]
    assert json.loads((tmp_path / "r.json").read_text())["made"] == len(made[0]) - 1


def test_other_options_do_not_continue_a_session(made, tmp_path):
    simulate.run(Simulate(tmp_path, subjects=1, poses=8))
    with pytest.raises(CommandError, match="--seed 0"):
        simulate.run(Simulate(tmp_path, subjects=1, poses=8, seed=1))


def test_a_session_of_before_the_natural_share_goes_on(made, tmp_path):
    simulate.run(Simulate(tmp_path, subjects=1, poses=8))
    file = tmp_path / "session.json"
    content = json.loads(file.read_text())
    del content["options"]["natural_share"]
    file.write_text(json.dumps(content))
    simulate.run(Simulate(tmp_path, subjects=1, poses=8))
    with pytest.raises(CommandError, match=r"--natural-share 0\.15"):
        simulate.run(Simulate(tmp_path, subjects=1, poses=8, natural_share=0.3))


def test_more_natural_poses_leave_the_other_scans_as_they_were():
    few, many = (
        plan_session(SimulationOptions(subjects=2, natural_share=share, bad_one_in=0))
        for share in (0.15, 0.5)
    )
    assert [scan.name for scan in few] == [scan.name for scan in many]
    natural_few, natural_many = (
        {scan.name for scan in plan if scan.protocol_pose == "natural"} for plan in (few, many)
    )
    assert natural_few < natural_many


def test_a_folder_that_cannot_be_made_is_said(made, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(CommandError, match="cannot be written"):
        simulate.run(Simulate(tmp_path / "file", subjects=1))


@pytest.mark.parametrize(
    "wrong", [{"subjects": 0}, {"poses": 0}, {"bad_one_in": -1}, {"workers": -1}, {"natural_share": 1.5}]
)
def test_wrong_numbers_are_refused(tmp_path, wrong):
    with pytest.raises(CommandError, match="expected"):
        simulate.run(Simulate(tmp_path, **wrong))
