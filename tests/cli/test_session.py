"""The register command on a session, with real registrations: pool, dask, two rounds, files on request."""

import json
import shutil

import numpy as np
import pytest
import trimesh

from corporeal.cli.main import main
from corporeal.model.files import open_model
from corporeal.model.jacobian import evaluate
from corporeal.registration.session.files import read_record, read_records
from corporeal.registration.starts import mean_pose

_SCANS = (("a_right", "right"), ("b_left", "left"), ("c_right", "right"))
_FLIP = np.array([-1.0, 1, 1])


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    """Three hands in one pose, one of them left, and an empty file; with the true vertices by name."""
    folder, truth, scans = tmp_path_factory.mktemp("session"), {}, []
    hand, rng = open_model("hand"), np.random.default_rng(11)
    for name, side in _SCANS:
        pose = 0.5 * mean_pose(hand) + 0.04 * rng.standard_normal((hand.joint_count, 3))
        pose[0] = 0
        vertices = evaluate(hand, 0.5 * rng.standard_normal(8), pose, np.array([0.1, 0.2, 0.3])).vertices
        faces = hand.faces
        if side == "left":
            vertices, faces = vertices * _FLIP, faces[:, ::-1]
        truth[name] = vertices
        trimesh.Trimesh(1e3 * vertices, faces, process=False).export(folder / f"{name}.ply")
        scans.append(
            {"name": name, "file": f"{name}.ply", "subject": name[0], "protocol_pose": "p", "side": side}
        )
    (folder / "d_bad.ply").write_bytes(b"")
    scans.append({"name": "d_bad", "file": "d_bad.ply", "subject": "d", "protocol_pose": "p", "side": "left"})
    (folder / "session.json").write_text(
        json.dumps({"format": "corporeal-session-1", "unit": "mm", "scans": scans})
    )
    return folder, truth


@pytest.fixture(scope="module")
def registered(session, tmp_path_factory):
    """The session registered twice over by the pool."""
    folder = tmp_path_factory.mktemp("registered")
    arguments = ["register", str(session[0]), "-o", str(folder / "reg"), "--json", str(folder / "out.json")]
    assert main([*arguments, "--workers", "2", "--rounds", "2"]) == 0
    return folder


@pytest.mark.slow
def test_every_scan_has_a_row_a_small_record_and_lies_on_its_truth(session, registered):
    items = json.loads((registered / "out.json").read_text())["items"]
    assert items == json.loads((registered / "reg" / "session.json").read_text())["items"]
    assert [(item["name"], item["side"], item["subject"]) for item in items] == [
        ("a_right", "right", "a"), ("b_left", "left", "b"), ("c_right", "right", "c"), ("d_bad", "left", "d"),
    ]  # fmt: skip
    assert [item["status"] for item in items] == ["ok", "ok", "ok", "failed"]
    assert "empty" in items[3]["reason"]
    assert {item["round"] for item in items} == {2} and {item["protocol_pose"] for item in items} == {"p"}
    assert items[0]["signals"]["s2m_mean_mm"] == items[0]["s2m_mm"]["mean"] < 0.2
    for name, vertices in session[1].items():
        path = registered / "reg" / "records" / f"{name}.npz"
        assert path.stat().st_size < 40_000
        record = read_record(path)
        assert 1e3 * np.linalg.norm(record.vertices - vertices, axis=1).mean() < 1.0
        assert record.side == name.split("_")[1]


@pytest.mark.slow
def test_dask_gives_the_same_numbers_and_writes_files_on_request(session, registered, tmp_path):
    arguments = ["register", str(session[0]), "-o", str(tmp_path / "reg"), "--dask", "local", "--outputs"]
    assert main([*arguments, "--workers", "1", "--rounds", "2"]) == 0
    for pool, dask in zip(read_records(registered / "reg"), read_records(tmp_path / "reg"), strict=True):
        for key in ("vertices", "pose", "shape", "translation"):
            np.testing.assert_array_equal(getattr(pool, key), getattr(dask, key))
        same = {key: value for key, value in pool.row.items() if key not in ("seconds", "outputs")}
        assert same == {key: dask.row[key] for key in same}
    for path in read_record(tmp_path / "reg" / "records" / "b_left.npz").row["outputs"].values():
        assert str(tmp_path / "reg" / "b_left") in path
    assert trimesh.load(tmp_path / "reg" / "b_left" / "hand.glb")


@pytest.mark.slow
def test_landmarks_found_before_give_the_same_registration_where_the_scan_is_the_same(
    session, registered, tmp_path, capsys
):
    copy = tmp_path / "session"
    shutil.copytree(session[0], copy)
    changed = copy / "c_right.ply"
    changed.write_bytes(changed.read_bytes().replace(b"trimesh", b"trimosh"))
    for number, landmarks in enumerate(([], ["--landmarks-from", str(tmp_path / "reg-0")])):
        source, target = (session[0], copy)[number], tmp_path / f"reg-{number}"
        assert main(["register", str(source), "-o", str(target), "--workers", "2", *landmarks]) == 0
    found, known = (read_records(tmp_path / f"reg-{number}") for number in range(2))
    for before, after in zip(found[:3], known[:3], strict=True):
        for key in ("vertices", "pose", "shape", "translation"):
            np.testing.assert_array_equal(getattr(before, key), getattr(after, key))
        np.testing.assert_array_equal(before.landmarks.positions, after.landmarks.positions)
        differing = {key for key, value in before.row.items() if value != after.row[key]}
        assert differing <= {"scan", "seconds", "notes", "sha256"}
    assert [record.row["notes"][0] for record in known[:2]] == ["landmarks of an earlier registration"] * 2
    said = known[2].row["notes"]
    assert "not used: the scan has changed" in said[0] and "virtual views" in said[1]
    options = ["--landmarks-from", str(tmp_path / "reg-0"), "--unit", "m"]
    assert main(["register", str(copy), "-o", str(tmp_path / "reg-2"), *options]) == 2
    assert "found with unit mm, and now it is m" in capsys.readouterr().err


def test_a_changed_option_is_named_and_exits_with_two(session, registered, capsys):
    arguments = ["register", str(session[0]), "-o", str(registered / "reg"), "--rounds", "2"]
    assert main([*arguments, "--no-correctives"]) == 2
    assert "option correctives: True -> False" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--workers", "0"], "at least one"),
        (["--landmarks", "marks.json"], "--landmarks goes with one scan"),
        (["--landmarks-from", "nowhere"], "nowhere: holds no records"),
    ],
)
def test_wrong_calls_exit_with_two_and_say_why(session, tmp_path, capsys, arguments, words):
    assert main(["register", str(session[0]), "-o", str(tmp_path / "reg"), *arguments]) == 2
    assert words in capsys.readouterr().err


def test_an_empty_folder_and_options_of_a_session_for_a_file_are_refused(session, tmp_path, capsys):
    (tmp_path / "empty").mkdir()
    assert main(["register", str(tmp_path / "empty"), "-o", str(tmp_path / "reg")]) == 2
    assert "no session.json and no file" in capsys.readouterr().err
    file = str(session[0] / "a_right.ply")
    assert main(["register", file, "-o", str(tmp_path / "reg"), "--rounds", "2"]) == 2
    assert "--rounds goes with the folder of a session" in capsys.readouterr().err
