import contextlib
import importlib.util
import json
import os
import queue
import signal
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pytest
from PIL import Image
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

_PLACE = Path(__file__).with_name("made_session.py")
_SPEC = importlib.util.spec_from_file_location("made_session", _PLACE)
made_session = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(made_session)

COUNT = 40


@pytest.fixture(scope="module")
def registered(tmp_path_factory) -> Path:
    return made_session.make_session(tmp_path_factory.mktemp("made"), COUNT, np.random.default_rng(3))[1]


@contextlib.contextmanager
def served(results: Path) -> Iterator[tuple[str, subprocess.Popen]]:
    """The command in a process of its own; its address and the process."""
    command = [
        sys.executable,
        "-m",
        "corporeal.cli.main",
        "curate",
        str(results),
        "--no-browser",
        "--port",
        "0",
    ]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    lines: queue.Queue[str] = queue.Queue()
    threading.Thread(target=lambda: [lines.put(line) for line in process.stdout], daemon=True).start()
    try:
        address = ""
        while not address.startswith("http"):
            address = lines.get(timeout=60).strip()
        yield address, process
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
            try:
                process.wait(timeout=15)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        process.stdout.close()


def decisions(results: Path) -> list[dict]:
    path = results / "decisions.jsonl"
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def status_of(address: str, **headers: str) -> int:
    try:
        with urllib.request.urlopen(urllib.request.Request(address, headers=headers), timeout=10) as answer:
            return answer.status
    except urllib.error.HTTPError as error:
        error.close()
        return error.code


def websocket_status(address: str, **headers: str) -> int:
    try:
        with connect(
            address, additional_headers=headers, subprotocols=[f"viser-v{version('viser')}"], open_timeout=10
        ):
            return 101
    except InvalidStatus as error:
        return error.response.status_code


def test_requests_without_the_token_are_refused(registered):
    with served(registered) as (address, _):
        parts = urlsplit(address)
        bare, port, token = f"http://{parts.netloc}", parts.port, parts.query.removeprefix("token=")
        assert parts.hostname == "127.0.0.1" and len(token) >= 32
        good = {"Cookie": f"corporeal_{port}={token}"}
        for path in ("/", "/index.html", "/sheet", "/go?name=s00_p00_right", "/thumbnail?name=s00_p00_right"):
            assert status_of(bare + path) == 403
            assert status_of(bare + path, Cookie=f"corporeal_{port}={token[::-1]}") == 403
        assert status_of(bare + "/?token=") == 403
        assert status_of(bare, **good) == 200
        assert status_of(bare + "/sheet", **good) == 200
        assert status_of(bare, Origin="http://evil.example", **good) == 403
        assert status_of(bare, Host=f"evil.example:{port}", **good) == 403
        socket = f"ws://{parts.netloc}"
        assert websocket_status(socket) == 403
        assert websocket_status(socket + "/?token=wrong") == 403
        assert websocket_status(socket, **good) == 101
        assert websocket_status(socket, Origin="http://127.0.0.1:1", **good) == 403


def test_it_listens_on_this_machine_only(registered):
    with served(registered) as (address, process):
        port = f":{urlsplit(address).port:04X}"
        listening = [
            line.split()[1]
            for table in ("tcp", "tcp6")
            for line in Path(f"/proc/{process.pid}/net/{table}").read_text().splitlines()[1:]
            if line.split()[3] == "0A" and line.split()[1].endswith(port)
        ]
        assert listening == ["0100007F" + port]


def shown(page, decided: int, name: str | None = None) -> str:
    """Wait until so many are decided (and a scan is shown); the name of the scan."""
    wanted = f"#curation[data-decided='{decided}']" + (f"[data-name='{name}']" if name else "")
    return page.wait_for_selector(wanted, timeout=120_000, state="attached").get_attribute("data-name")


def kill_browser(profile: Path) -> None:
    """SIGKILL to the one browser that was started with this profile."""
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            with contextlib.suppress(OSError):
                words = (entry / "cmdline").read_bytes().split(b"\0")
                if f"--user-data-dir={profile}".encode() in words and not any(b"--type=" in w for w in words):
                    os.kill(int(entry.name), signal.SIGKILL)


def colours_in_the_middle(page, folder: Path) -> int:
    """Different colours in the middle of the page: one, the background, where nothing is drawn."""
    page.screenshot(path=str(folder / "page.png"), clip={"x": 420, "y": 150, "width": 440, "height": 500})
    pixels = np.asarray(Image.open(folder / "page.png").convert("RGB")).reshape(-1, 3)
    return len(np.unique(pixels, axis=0))


def decided_by_keyboard(page, results: Path, wanted: list[str], names: list[str]) -> list[float]:
    """Press the keys; every decision is on the disk before the page says so. Seconds per scan."""
    seconds = []
    for number, decision in enumerate(wanted):
        begun = time.perf_counter()
        page.keyboard.press("r" if decision == "reject" else "a")
        shown(page, number + 1, names[number + 1])
        assert len(decisions(results)) == number + 1
        seconds.append(time.perf_counter() - begun)
    return seconds


@pytest.mark.slow
def test_thirty_decisions_by_keyboard_survive_a_killed_browser(registered, browser, tmp_path):
    results = registered
    names = sorted(path.stem for path in (results / "records").glob("*.npz"))
    wanted = {name: "reject" if number % 3 == 2 else "accept" for number, name in enumerate(names[:30])}
    with served(results) as (address, process):
        with browser(tmp_path / "one", 1280, 800) as page:
            page.goto(address)
            assert "token" not in page.url
            shown(page, 0, names[0])
            seconds = decided_by_keyboard(page, results, list(wanted.values()), names)
            # The scene is drawn after the words; the hand fills a part of its middle.
            page.wait_for_timeout(4000)
            assert colours_in_the_middle(page, tmp_path) > 30
            print(f"median {np.median(seconds):.2f} s, worst {max(seconds):.2f} s per scan")
            kill_browser(tmp_path / "one")
        assert {entry["name"]: entry["decision"] for entry in decisions(results)} == wanted
        process.kill()
        process.wait()
    # The crash cut off a line; it is dropped, the thirty are not.
    with (results / "decisions.jsonl").open("ab") as file:
        file.write(b'{"name": "s0')
    with served(results) as (address, _), browser(tmp_path / "two", 1280, 800) as page:
        page.goto(address)
        assert shown(page, 30, names[30]) == names[30]
        page.keyboard.press("u")
        assert shown(page, 29, names[29]) == names[29]
        page.keyboard.press("ArrowRight")
        shown(page, 29, names[30])
        page.keyboard.press("ArrowLeft")
        shown(page, 29, names[29])
        page.get_by_role("button", name="reject (r)").click()
        shown(page, 30, names[30])
        page.goto(address.partition("?")[0] + "sheet")
        assert page.locator("main a").count() == COUNT
        page.wait_for_function("document.querySelector('main img').naturalWidth > 100", timeout=30_000)
        assert page.locator("main a.reject").count() == 10
        page.locator("main a").nth(35).click()
        assert shown(page, 30, names[35]) == names[35]
    replayed = {}
    for entry in decisions(results):
        replayed[entry["name"]] = entry["decision"]
    assert replayed == wanted
