"""``corporeal view``: what is read of tracks, what is refused, and the page in a real browser."""

import contextlib
import importlib.util
import json
import os
import queue
import shutil
import signal
import subprocess
import sys
import threading
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from corporeal.cli.errors import CommandError
from corporeal.cli.main import main
from corporeal.cli.viewed_track import ViewedTrack
from corporeal.cli.viewed_tracks import find_tracks
from corporeal.model.files import load_model

_PATH = Path(__file__).with_name("made_track.py")
_SPEC = importlib.util.spec_from_file_location("made_track", _PATH)
made = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(made)

COUNT = 6


@pytest.fixture(scope="module")
def sequence(tmp_path_factory):
    return made.made_sequence.make_sequence(tmp_path_factory.mktemp("capture") / "seq", COUNT)


@pytest.fixture
def folder(sequence, tmp_path):
    """Of a track of the first four frames: the second is doubtful, the third failed."""
    return made.make_track(sequence, tmp_path / "out", 4, {1: "doubtful", 2: "failed"})


def read(folder, scans=None):
    track = ViewedTrack(folder, scans)
    track.refresh()
    return track


def test_rows_say_what_the_records_say(folder):
    track = read(folder)
    assert (track.name, track.note, track.fps) == ("open-hand", "", made.made_sequence.FPS)
    assert [(row.name, row.status, row.reason, row.s2m_mm) for row in track.rows] == [
        ("0000", "ok", "", 0.5),
        ("0001", "doubtful", "because 1", 1.5),
        ("0002", "failed", "because 2", None),
        ("0003", "ok", "", 3.5),
    ]
    assert track.rows[0].seen == (("model", 0.9), ("right hand", 0.8))


def test_vertices_are_those_of_the_poses_in_every_block(sequence, folder):
    track, truth = read(folder), np.load(sequence / "truth.npy")
    for start, stop in ((0, 4), (2, 4), (3, 4), (1, 2)):
        found = track.vertices(start, stop)
        assert found.dtype == np.float32
        # float32 against float64: micrometres.
        np.testing.assert_allclose(found, truth[start:stop], atol=3e-6)
    assert track.faces().max() == truth.shape[1] - 1


def test_a_scan_lies_where_it_lies_with_the_colours_of_its_distance(sequence, folder):
    track, truth = read(folder), np.load(sequence / "truth.npy")
    scan = track.scan(3)
    assert scan.note == ""
    np.testing.assert_allclose(scan.points, truth[3], atol=1e-6)
    # All points lie on the model: one colour, that of no distance; of the frame that failed nothing is known.
    assert len(np.unique(scan.colours, axis=0)) == 1 and (scan.colours[0, 2] > 2 * scan.colours[0, 0])
    grey = np.unique(track.scan(2).colours, axis=0)
    assert len(grey) == 1 and np.ptp(grey[0].astype(int)) < 30


def test_a_scan_that_is_missing_or_broken_costs_itself_only(sequence, folder, tmp_path):
    copied = tmp_path / "moved"
    shutil.copytree(sequence, copied)
    (copied / "scans" / "0000.ply").unlink()
    (copied / "scans" / "0001.ply").write_bytes(b"ply\nbroken")
    (copied / "scans" / "0003.ply").write_bytes(b"")
    for scans in (copied, copied / "scans"):
        track = read(folder, scans)
        assert "0000.ply" in track.scan(0).note and "--scans" in track.scan(0).note
        assert "0001.ply" in track.scan(1).note and len(track.scan(1).points) == 0
        assert "empty" in track.scan(3).note
        assert len(track.scan(2).points) == len(np.load(sequence / "truth.npy")[2])


def test_a_track_that_does_not_say_where_its_scans_lie_asks_for_them(sequence, folder):
    path = folder / "template.json"
    story = json.loads(path.read_text())
    del story["sequence"]
    path.write_text(json.dumps(story))
    track = read(folder)
    assert track.fps == 60.0 and "--scans DIR" in track.scan(0).note
    assert read(folder, sequence).scan(0).note == ""
    assert read(folder, sequence.parent).scan_path(0) == sequence.parent / "scans" / "0000.ply"


def test_what_a_running_track_writes_is_read_when_it_is_there(sequence, folder):
    track, model = read(folder), load_model(sequence.parent / "template.npz")
    made.write_made_frame(folder, model, 5)
    # A record behind a gap is of an earlier run: a sequence is tracked in order.
    assert not track.refresh() and len(track.rows) == 4
    made.write_made_frame(folder, model, 4, "doubtful")
    assert not track.refresh()
    assert [row.status for row in track.rows] == ["ok", "doubtful", "failed", "ok", "doubtful", "ok"]
    np.testing.assert_allclose(track.vertices(4, 6), np.load(sequence / "truth.npy")[4:6], atol=3e-6)
    made.write_made_frame(folder, model, 1)
    assert track.refresh() and track.rows[1].status == "ok"
    (folder / "frames" / "0002.npz").unlink()
    assert track.refresh() and len(track.rows) == 2


def test_a_damaged_record_costs_itself_only(sequence, folder):
    (folder / "frames" / "0001.npz").write_bytes(b"nothing")
    track, truth = read(folder), np.load(sequence / "truth.npy")
    assert [row.status for row in track.rows] == ["ok", "failed", "failed", "ok"]
    assert "record" in track.rows[1].reason
    # It stands as the frame before.
    np.testing.assert_allclose(track.vertices(0, 4), truth[[0, 0, 2, 3]], atol=3e-6)


def test_rows_of_the_report_are_taken_where_no_record_is_newer(folder):
    items = [
        {"frame": f"{i:04d}", "status": "ok", "reason": "of the report", "s2m_mm": None, "signals": {}}
        for i in range(4)
    ]
    report = {"sequence": {"name": "open-hand", "folder": "/nowhere", "fps": 30.0}, "items": items}
    (folder / "report.json").write_text(json.dumps(report))
    assert [row.reason for row in read(folder).rows] == ["of the report"] * 4
    record = folder / "frames" / "0001.npz"
    content = record.read_bytes()
    record.write_bytes(content)
    later = (folder / "report.json").stat().st_mtime_ns + 10**9
    os.utime(record, ns=(later, later))
    assert [row.reason for row in read(folder).rows] == [
        "of the report", "because 1", "of the report", "of the report"
    ]  # fmt: skip


def test_all_sequences_of_a_folder_are_found_and_so_is_the_folder_of_one(sequence, folder, monkeypatch):
    out = folder.parent
    failed = out / "a-failed"
    failed.mkdir()
    item = {"frame": None, "status": "failed", "reason": "nobody is there"}
    report = {"sequence": {"name": "a-failed"}, "items": [item]}
    (failed / "report.json").write_text(json.dumps(report))
    tracks = find_tracks(out, None)
    assert [(track.name, len(track.rows)) for track in tracks] == [("a-failed", 0), ("open-hand", 4)]
    assert "nobody is there" in tracks[0].note
    assert [track.name for track in find_tracks(out, None, ["open-hand"])] == ["a-failed"]
    assert [track.name for track in find_tracks(folder, None)] == ["open-hand"]
    monkeypatch.chdir(folder)
    assert [track.name for track in find_tracks(Path("."), None)] == ["open-hand"]
    with pytest.raises(CommandError, match="nobody is there"):
        find_tracks(failed, None)


def _spoilt_story(out):
    (out / "seq").mkdir()
    (out / "seq" / "template.json").write_text("{broken")


def _session(out):
    (out / "records").mkdir()
    (out / "records" / "a.npz").write_bytes(b"")
    (out / "manifest.json").write_text("{}")


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda out: out.rmdir(), "does not exist"),
        (lambda out: (out.rmdir(), out.write_text("")), "is a file"),
        (lambda out: None, "holds no track"),
        (_session, "corporeal curate"),
        (lambda out: (out / "sequence.json").write_text("{}"), "corporeal track"),
        (lambda out: (out / "session.json").write_text("{}"), "corporeal register"),
        (lambda out: (out / "registration.npz").write_text(""), "registration of one scan"),
        (lambda out: (out / "seq" / "frames").mkdir(parents=True), "no template yet"),
        (_spoilt_story, "template.json"),
    ],
)
def test_what_is_no_track_is_an_error_that_says_what_to_do(make, words, tmp_path, capsys):
    out = tmp_path / "out"
    out.mkdir()
    make(out)
    assert main(["view", str(out), "--no-browser"]) in (1, 2)
    said = capsys.readouterr().err
    assert said.startswith("corporeal: ") and words in said and "Traceback" not in said
    assert len(said.splitlines()) == 1


def test_options_that_make_no_sense_are_refused(folder, capsys, monkeypatch):
    assert main(["view", str(folder), "--no-browser", "--scans", str(folder / "none")]) == 2
    assert "--scans" in capsys.readouterr().err
    assert main(["view", str(folder), "--no-browser", "--port", "70000"]) == 2
    assert "0 to 65535" in capsys.readouterr().err
    (folder / "template.npz").write_bytes(b"damaged")
    assert main(["view", str(folder), "--no-browser"]) == 2
    assert "template.npz" in capsys.readouterr().err
    monkeypatch.setitem(sys.modules, "viser", None)
    for name in [name for name in sys.modules if name.startswith("corporeal.view")]:
        monkeypatch.delitem(sys.modules, name)
    assert main(["view", str(folder), "--no-browser"]) == 2
    assert "corporeal[view]" in capsys.readouterr().err


@contextlib.contextmanager
def served(folder: Path) -> Iterator[tuple[str, subprocess.Popen]]:
    """The command in a process of its own; its address and the process."""
    command = [sys.executable, "-m", "corporeal.cli.main", "view", str(folder), "--no-browser", "--port", "0"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    lines: queue.Queue[str] = queue.Queue()
    threading.Thread(target=lambda: [lines.put(line) for line in process.stdout], daemon=True).start()
    try:
        address = ""
        while not address.startswith("http"):
            address = lines.get(timeout=180).strip()
        yield address, process
    finally:
        if process.poll() is None:
            process.kill()
            process.wait()
        process.stdout.close()
        process.stderr.close()


def colours_of(page, path: Path) -> int:
    """Different colours left of the panel: one, the background, where nothing is drawn."""
    page.screenshot(path=str(path), clip={"x": 20, "y": 170, "width": 380, "height": 300})
    return len(np.unique(np.asarray(Image.open(path).convert("RGB")).reshape(-1, 3), axis=0))


def status_of(address: str) -> int:
    try:
        with urllib.request.urlopen(address, timeout=30) as answer:
            return answer.status
    except urllib.error.HTTPError as error:
        error.close()
        return error.code


def shown(page, words: str) -> None:
    page.wait_for_selector(f"#player{words}", timeout=90_000, state="attached")


@pytest.mark.slow
def test_the_page_plays_steps_jumps_and_reads_later_frames(sequence, folder, browser, tmp_path):
    with served(folder.parent) as (address, process):
        assert status_of(address.partition("?")[0] + "do?action=toggle") == 403
        # Small: without a GPU the time of the test is that of drawing.
        with browser(tmp_path / "profile", 800, 500) as page:
            page.goto(address)
            assert "token" not in page.url
            shown(page, "[data-frame='0'][data-scan='0'][data-count='4'][data-playing='0']")
            page.wait_for_timeout(3000)
            assert colours_of(page, tmp_path / "page.png") > 100
            page.keyboard.press("Space")
            shown(page, "[data-playing='1']")
            for frame in (1, 3):
                shown(page, f"[data-frame='{frame}'][data-playing='1']")
            page.keyboard.press("Space")
            shown(page, "[data-playing='0']")
            page.keyboard.press("Home")
            shown(page, "[data-frame='0'][data-playing='0']")
            for key, frame, status in (
                ("ArrowRight", 1, "doubtful"), ("ArrowLeft", 0, "ok"), ("n", 1, "doubtful"),
                ("n", 2, "failed"), ("p", 1, "doubtful"),
            ):  # fmt: skip
                page.keyboard.press(key)
                shown(page, f"[data-frame='{frame}'][data-scan='{frame}'][data-status='{status}']")
            page.locator("#problems [data-go='2']").click()
            shown(page, "[data-frame='2']")
            made.write_made_frame(folder, load_model(sequence.parent / "template.npz"), 4)
            page.get_by_role("button", name="refresh").click()
            shown(page, "[data-count='5'][data-frame='2']")
            page.keyboard.press("End")
            shown(page, "[data-frame='4'][data-scan='4']")
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=60) == 0
        assert "Traceback" not in process.stderr.read()
