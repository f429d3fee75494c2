"""``corporeal track`` on a hand in motion: what lies on the disk, faults, what resumes, what is refused."""

import importlib.util
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from threadpoolctl import threadpool_limits

from corporeal.cli.main import main
from corporeal.export.gltf_check import GlbFile
from corporeal.fitting.files import load_subject_template, read_frame, read_story
from corporeal.model.jacobian import evaluate
from corporeal.registration.session.jobs import News
from corporeal.scans.files import read_scan

COUNT = 5
_PATH = Path(__file__).with_name("made_sequence.py")
_SPEC = importlib.util.spec_from_file_location("made_sequence", _PATH)
made = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(made)
_NAMES = [
    "fingers.npz", "frames", "report.json", "sheet.png", "template.json", "template.npz", "track.glb",
    "track.npz",
]  # fmt: skip


@pytest.fixture(scope="module")
def sequence(tmp_path_factory):
    return made.make_sequence(tmp_path_factory.mktemp("capture") / "seq", COUNT)


def _in_this_process(news):
    """Runs jobs: starting another process takes longer than they do. News go to the list too."""

    def execute(setup, jobs, workers, lost):
        worker = setup.start()
        for job in jobs:
            told = []
            worker.tell = told.append
            # Workers of the pool have one thread; sums over several round otherwise.
            with threadpool_limits(1):
                outcome = worker(job)
            yield from ((job, News(content)) for content in told)
            news.extend(told)
            yield job, outcome

    return execute


@pytest.fixture
def here(monkeypatch):
    """Jobs run in this process. Gives the news that were told."""
    news = []
    monkeypatch.setattr(import_module("corporeal.cli.track"), "run_local", _in_this_process(news))
    return news


def _call(sequence, output, *arguments):
    beside = sequence.parent
    handed = ["--template", str(beside / "template.npz"), "--start", str(beside / "start.npz")]
    return ["track", str(sequence), "-o", str(output), *handed, *arguments]


@pytest.fixture(scope="module")
def tracked(sequence, tmp_path_factory):
    """Tracked without interruption."""
    output = tmp_path_factory.mktemp("tracked")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(import_module("corporeal.cli.track"), "run_local", _in_this_process([]))
        assert main(_call(sequence, output / "out", "--meshes", "--json", str(output / "all.json"))) == 0
    return output


def _copied(sequence, folder):
    """The sequence with what lies beside it, to be spoiled."""
    shutil.copytree(sequence.parent, folder)
    return folder / sequence.name


def _arrays(folder):
    """All numbers of all records and of the motion, without the seconds."""
    found = {}
    for path in [*sorted((folder / "frames").glob("*.npz")), folder / "track.npz"]:
        with np.load(path, allow_pickle=False) as archive:
            found |= {(path.name, key): archive[key] for key in archive.files if key != "seconds"}
    return found


def _assert_same(first, second):
    assert first.keys() == second.keys()
    for key, array in first.items():
        assert array.dtype == second[key].dtype and array.tobytes() == second[key].tobytes(), key


def test_every_frame_lies_on_its_truth_and_every_promised_file_is_there(sequence, tracked):
    folder = tracked / "out" / "open-hand"
    assert sorted(path.name for path in folder.iterdir() if path.name[0] != ".") == sorted(
        [*_NAMES, "meshes"]
    )
    truth, template = np.load(sequence / "truth.npy"), load_subject_template(folder)
    for number in range(COUNT):
        frame = read_frame(folder / "frames" / f"{number:04d}.npz").frame
        vertices = evaluate(template.model, np.zeros(0), frame.pose, frame.translation).vertices
        assert frame.status == "ok"
        assert 1e3 * np.linalg.norm(vertices - truth[number], axis=1).mean() < 1.0
        mesh = read_scan(folder / "meshes" / f"{number:04d}.ply", "m")
        np.testing.assert_allclose(mesh.points, vertices + frame.offsets, atol=1e-6)


def test_the_report_has_an_item_per_frame_and_json_has_those_of_all_sequences(sequence, tracked):
    report = json.loads((tracked / "out" / "open-hand" / "report.json").read_text())
    assert [item["frame"] for item in report["items"]] == [f"{number:04d}" for number in range(COUNT)]
    for item in report["items"]:
        assert set(item) == {"frame", "status", "reason", "seconds", "s2m_mm", "signals"}
        assert set(item["seconds"]) == {"read", "sample", "fit", "free", "total"}
        assert set(item["s2m_mm"]) == {"mean", "median", "p95", "under_1mm"}
        assert item["s2m_mm"]["mean"] <= item["signals"]["model_s2m_mm"] < 1
        assert item["signals"]["model_seen"] > 0.9
    named = report["sequence"]
    # A track that is still running has no report: where its scans lie stands with the template.
    assert read_story(tracked / "out" / "open-hand")["sequence"] == named
    assert (named["name"], named["folder"], named["fps"]) == ("open-hand", str(sequence.resolve()), made.FPS)
    assert report["template"]["learned"] is False and report["template"]["start"]["given"] is True
    everything = json.loads((tracked / "all.json").read_text())
    assert everything["items"] == [{"sequence": "open-hand", **item} for item in report["items"]]
    assert everything["sequences"] == [{key: report[key] for key in report if key != "items"}]


def test_motion_animation_and_picture_show_the_records(tracked):
    folder = tracked / "out" / "open-hand"
    with np.load(folder / "track.npz", allow_pickle=False) as motion:
        assert motion["poses"].shape == (COUNT, 48) and motion["mocap_framerate"] == made.FPS
        assert motion["status"].tolist() == ["ok"] * COUNT and motion["template"] == "template.npz"
        for number, name in enumerate(motion["frame_names"]):
            frame = read_frame(folder / "frames" / f"{name}.npz").frame
            np.testing.assert_array_equal(motion["poses"][number], frame.pose.ravel())
            np.testing.assert_array_equal(motion["trans"][number], frame.translation)
    glb = GlbFile.read(folder / "track.glb")
    np.testing.assert_allclose(glb.key_times, np.arange(COUNT) / made.FPS, rtol=1e-6)
    picture = np.asarray(Image.open(folder / "sheet.png").convert("RGB")).astype(int)
    # Two rows of scan and fit: blue points, skin-coloured surface.
    assert ((picture[..., 2] - picture[..., 0]) > 60).mean() > 0.02
    assert ((picture[..., 0] - picture[..., 2]) > 40).mean() > 0.02


def test_broken_frames_cost_themselves_only(sequence, here, tmp_path, capsys):
    copy = _copied(sequence, tmp_path / "capture")
    scans = copy / "scans"
    (scans / "0000.ply").write_bytes(b"")
    (scans / "0002.ply").unlink()
    whole = (scans / "0003.ply").read_bytes()
    (scans / "0003.ply").write_bytes(whole[: len(whole) // 3])
    nan = np.frombuffer(whole, np.uint8).copy()
    start = whole.index(b"end_header\n") + 11
    nan[start : start + 12 * 2931] = np.frombuffer(np.full(3 * 2931, np.nan, "<f4").tobytes(), np.uint8)
    (scans / "0004.ply").write_bytes(nan.tobytes())
    assert main(_call(copy, tmp_path / "out")) == 0
    items = json.loads((tmp_path / "out" / "open-hand" / "report.json").read_text())["items"]
    assert [item["status"] for item in items] == ["failed", "ok", "failed", "failed", "failed"]
    for number, words in ((0, "empty"), (2, "cannot be read"), (3, "0003.ply"), (4, "0004.ply")):
        assert words in items[number]["reason"] and items[number]["s2m_mm"] is None
    said = capsys.readouterr().err
    assert "1 ok, 0 doubtful, 4 failed" in said and str(tmp_path / "out") in said
    assert here[-1] == {"step": "writing sheet.png"}
    with np.load(tmp_path / "out" / "open-hand" / "track.npz", allow_pickle=False) as motion:
        assert (motion["poses"] == motion["poses"][1]).all()
    # A frame that comes back is tracked, and all behind it again.
    shutil.copy(sequence / "scans" / "0003.ply", scans / "0003.ply")
    assert main(_call(copy, tmp_path / "out")) == 0
    items = json.loads((tmp_path / "out" / "open-hand" / "report.json").read_text())["items"]
    assert [item["status"] for item in items] == ["failed", "ok", "failed", "ok", "failed"]
    assert "0003.ply has changed since" in capsys.readouterr().err


def test_a_sequence_that_cannot_be_tracked_costs_one_item(sequence, here, tmp_path, capsys):
    empty = tmp_path / "empty"
    (empty / "scans").mkdir(parents=True)
    made.write_list(empty, "empty", [{"name": f"{k}", "file": f"scans/{k}.ply"} for k in range(3)])
    call = ["track", str(empty), "-o", str(tmp_path / "out"), "--model", "hand"]
    assert main(call) == 1
    item = json.loads((tmp_path / "out" / "empty" / "report.json").read_text())["items"]
    assert [(one["frame"], one["status"]) for one in item] == [(None, "failed")]
    assert "no frame can be read; 0" in item[0]["reason"]
    assert "empty: failed - no frame can be read" in capsys.readouterr().err


@pytest.mark.slow
def test_a_killed_run_goes_on_to_the_same_bits(sequence, tracked, here, tmp_path):
    """Killed on the pool, which leaves its worker an orphan; resumed here."""
    folder = tmp_path / "out" / "open-hand"
    environment = {**os.environ, "OMP_WAIT_POLICY": "PASSIVE"}
    command = [
        sys.executable,
        "-m",
        "corporeal.cli.main",
        *_call(sequence, tmp_path / "out", "--workers", "1"),
    ]
    process = subprocess.Popen(command, env=environment, stderr=subprocess.PIPE)
    try:
        ends = time.monotonic() + 120
        while not (folder / "frames" / "0001.npz").exists():
            assert process.poll() is None and time.monotonic() < ends, process.stderr.read()
            time.sleep(0.01)
    finally:
        process.send_signal(signal.SIGKILL)
        process.communicate()
    assert process.returncode == -signal.SIGKILL
    kept = read_frame(folder / "frames" / "0001.npz").frame.seconds
    assert not (folder / "track.npz").exists() and not (folder / "frames" / f"{COUNT - 1:04d}.npz").exists()
    assert main(_call(sequence, tmp_path / "out")) == 0
    assert read_frame(folder / "frames" / "0001.npz").frame.seconds == kept
    _assert_same(_arrays(folder), _arrays(tracked / "out" / "open-hand"))


def test_frames_can_be_added_and_a_damaged_record_is_made_again(sequence, tracked, here, tmp_path, capsys):
    folder = tmp_path / "out" / "open-hand"
    assert main(_call(sequence, tmp_path / "out", "--frames", "3")) == 0
    assert json.loads((folder / "report.json").read_text())["sequence"]["frames"] == 3
    record = folder / "frames" / "0002.npz"
    record.write_bytes(record.read_bytes()[:200])
    assert main(_call(sequence, tmp_path / "out")) == 0
    said = capsys.readouterr().err
    assert "2 frames were added" in said and "the record of 0002 was damaged" in said
    _assert_same(_arrays(folder), _arrays(tracked / "out" / "open-hand"))
    assert main(_call(sequence, tmp_path / "out", "--frames", "3")) == 2
    assert "frame 3: 0003" in capsys.readouterr().err


def test_results_of_something_else_are_refused_until_restart(sequence, tracked, here, tmp_path, capsys):
    output = tmp_path / "out"
    shutil.copytree(tracked / "out", output)
    other = ["track", str(sequence), "-o", str(output), "--model", "hand", "--start"]
    assert main([*other, str(sequence.parent / "start.npz")]) == 2
    said = capsys.readouterr().err
    assert "template given: True -> False" in said and "--restart" in said
    (output / "open-hand" / "template.json").write_text("{}")
    assert main(_call(sequence, output)) == 2
    assert "template.json: expected" in capsys.readouterr().err
    assert main(_call(sequence, output, "--restart", "--frames", "1")) == 0
    assert [path.name for path in (output / "open-hand" / "frames").iterdir()] == ["0000.npz"]
    assert not list((output / "open-hand" / "meshes").iterdir())


def test_a_template_is_learned_and_kept(sequence, here, tmp_path, capsys):
    start = ["--model", "hand", "--start", str(sequence.parent / "start.npz"), "--template-frames", "1"]
    copy = _copied(sequence, tmp_path / "capture")
    (copy / "scans" / "0000.ply").write_bytes(b"ply")
    call = ["track", str(copy), "-o", str(tmp_path / "out"), *start]
    assert main([*call, "--frames", "2"]) == 0
    folder = tmp_path / "out" / "open-hand"
    report = json.loads((folder / "report.json").read_text())
    assert report["template"]["used"] == ["0001"] and "0000" in report["template"]["rejected"]
    assert report["template"]["start"]["frame"] == "0001"
    written = (folder / "template.npz").stat().st_mtime_ns
    assert main([*call, "--frames", "2"]) == 0
    assert (folder / "template.npz").stat().st_mtime_ns == written
    shutil.copy(sequence / "scans" / "0004.ply", copy / "scans" / "0001.ply")
    assert main([*call, "--frames", "2"]) == 2
    assert "0001.ply, which the template was learned from" in capsys.readouterr().err


def test_json_goes_to_the_standard_output_and_a_plain_folder_is_a_sequence(sequence, here, tmp_path, capsys):
    plain = tmp_path / "plain"
    plain.mkdir()
    for number in (0, 1):
        shutil.copy(sequence / "scans" / f"{number:04d}.ply", plain / f"f{9 + number}.ply")
    handed = _call(sequence, tmp_path / "out", "--json", "-")[4:]
    assert main(["track", str(plain), "-o", str(tmp_path / "out"), *handed]) == 0
    captured = capsys.readouterr()
    result = json.loads(captured.out)
    assert [item["frame"] for item in result["items"]] == ["f9", "f10"]
    assert read_story(tmp_path / "out" / "plain")["unit"] == "mm"
    assert "no sequence.json" in captured.err and "no sequence.json" in result["sequences"][0]["notes"][0]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nowhere"], "nowhere does not exist"),
        (["{seq}", "{seq}"], "2 sequences named 'open-hand'"),
        (["{seq}", "--workers", "0"], "--workers 0: at least one"),
        (["{seq}", "--frames", "0"], "--frames 0: at least one"),
        (["{seq}", "--template", "x.npz", "--template-frames", "3"], "--template-frames"),
        (["{seq}", "--template", "x.npz", "--model", "hand"], "--model: with --template"),
        (["{seq}", "--template", "x.npz"], "--template x.npz"),
        (["{seq}", "--model", "hand", "--start", "{seq}/../body_start.npz"], "has 55 joints, the model 16"),
        (["{seq}", "{seq}", "--start", "s.npz"], "--start goes with one sequence"),
    ],
)
def test_wrong_calls_exit_with_two_and_say_why(sequence, tmp_path, capsys, arguments, words):
    filled = [argument.format(seq=sequence) for argument in arguments]
    assert main(["track", *filled, "-o", str(tmp_path / "out")]) == 2
    assert words in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
