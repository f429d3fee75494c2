"""The register command: rows, exit statuses, files, and that one bad scan costs one row."""

import json

import numpy as np
import pytest
import trimesh

from corporeal.cli.main import main
from corporeal.model.files import open_model
from corporeal.model.jacobian import evaluate
from corporeal.registration.starts import mean_pose


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    """A clean capture of the open hand in millimetres with its 21 landmarks beside it."""
    folder = tmp_path_factory.mktemp("capture")
    hand = open_model("hand")
    posed = evaluate(hand, np.full(5, 0.5), mean_pose(hand), np.array([0.1, 0.2, 0.3]))
    trimesh.Trimesh(1e3 * posed.vertices, hand.faces, process=False).export(folder / "clean.ply")
    landmark_set = hand.landmarks["hand_21_mediapipe"]
    points = 1e3 * landmark_set.positions(posed.vertices, posed.joints)
    (folder / "marks.json").write_text(
        json.dumps({name: point.tolist() for name, point in zip(landmark_set.names, points, strict=True)})
    )
    return folder


def _register(capture, tmp_path, *arguments):
    result = tmp_path / "result.json"
    status = main(["register", *arguments, "-o", str(tmp_path / "out"), "--json", str(result)])
    return status, json.loads(result.read_text())["items"]


def test_one_scan_gives_every_promised_file_and_key(capture, tmp_path):
    marks = ["--landmarks", str(capture / "marks.json")]
    status, (item,) = _register(capture, tmp_path, str(capture / "clean.ply"), *marks)
    assert status == 0 and item["status"] == "ok", item["reason"]
    assert item["side"] == "right" and item["unit"] == "mm"
    assert set(item["seconds"]) >= {"total", "landmarks", "fit"}
    for key in ("s2m_mm", "model_s2m_mm"):
        assert set(item[key]) >= {"mean", "median", "p95", "under_1mm"}
    assert item["s2m_mm"]["mean"] < 0.2
    folder = tmp_path / "out" / "clean"
    expected = {
        "registration.npz",
        "registration.ply",
        "model.ply",
        "hand.glb",
        "overview.png",
        "report.json",
    }
    assert {path.name for path in folder.iterdir()} == expected
    archive = np.load(folder / "registration.npz", allow_pickle=False)
    in_own_unit = trimesh.load(folder / "registration.ply", process=False)
    assert np.abs(1e3 * archive["vertices"] - in_own_unit.vertices).max() < 1e-3
    assert archive["pose"].shape == (16, 3) and str(archive["side"]) == "right"


def test_a_bad_scan_costs_one_row(capture, tmp_path):
    bad = tmp_path / "bad.ply"
    bad.write_bytes(b"ply\nformat ascii 1.0\nelement vertex 10\n")
    status, items = _register(capture, tmp_path, str(bad), str(capture / "clean.ply"), "--side", "right")
    assert status == 0
    assert [item["status"] == "failed" for item in items] == [True, False]
    assert "bad.ply" in items[0]["reason"]


@pytest.mark.parametrize("content", [b"", b"ply\nformat ascii 1.0\nend_header\n", b"garbage"])
def test_the_only_scan_failed_exits_with_one(capture, tmp_path, content):
    bad = tmp_path / "bad.ply"
    bad.write_bytes(content)
    status, (item,) = _register(capture, tmp_path, str(bad))
    assert status == 1 and item["status"] == "failed" and item["s2m_mm"] is None


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--model", "no-such-model.npz"], "no-such-model"),
        (["--landmarks", "nowhere.json"], "nowhere.json"),
    ],
)
def test_wrong_calls_exit_with_two_and_say_why(capture, tmp_path, capsys, arguments, words):
    status = main(["register", str(capture / "clean.ply"), "-o", str(tmp_path), *arguments])
    assert status == 2
    assert words in capsys.readouterr().err


def test_two_scans_of_one_name_are_refused(capture, tmp_path):
    twin = tmp_path / "clean.ply"
    twin.write_bytes((capture / "clean.ply").read_bytes())
    assert main(["register", str(capture / "clean.ply"), str(twin), "-o", str(tmp_path / "out")]) == 2
