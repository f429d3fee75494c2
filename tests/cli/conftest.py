"""Registered sessions without scans, for learning to read, and a real browser for pages."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from corporeal.model.files import open_model, save_model
from corporeal.model.jacobian import evaluate
from corporeal.model.surface_model import SurfaceModel
from corporeal.registration.session.files import make_folder, record_path, write_record
from corporeal.registration.session.model_digest import model_digest
from corporeal.registration.session.records import SessionRecord

CHROMIUM = Path("/usr/bin/chromium")
CHROMIUM_FLAGS = [
    "--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--disable-gpu", "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
]  # fmt: skip
_TURN = np.array([1.0, -1.0, -1.0])
_FLIP = np.array([-1.0, 1.0, 1.0])


def _made_records(model: SurfaceModel, people: int, poses: int, seed: int = 4) -> list[SessionRecord]:
    """Every person's right hand, the first one's left too, in poses as recorded, with 0.2 mm of noise.

    Not turned at random: learning knows of the start model's recorded poses which joints are hinges.
    """
    rng, records = np.random.default_rng(seed), []
    for person in range(people):
        shape = rng.standard_normal(model.shape_count)
        for side in ("right", "left") if person == 0 else ("right",):
            for number in range(poses):
                name = f"s{person:02}_p{number:02}_{side}"
                pose = 0.35 * rng.standard_normal((model.joint_count, 3))
                for block in model.pose_blocks:
                    drawn = rng.standard_normal(len(block.components)) * block.component_deviations
                    pose[list(block.joints)] = (block.mean + drawn @ block.components).reshape(-1, 3)
                translation = 0.1 * rng.standard_normal(3)
                vertices = evaluate(model, shape, pose, translation).vertices
                vertices = vertices + 0.0002 * rng.standard_normal(vertices.shape)
                if side == "left":
                    vertices, pose, translation = vertices * _FLIP, pose * _TURN, translation * _FLIP
                row = {
                    "name": name, "scan": f"{name}.ply", "status": "ok", "reason": "", "side": side,
                    "subject": f"s{person:02}", "protocol_pose": f"p{number:02}", "sha256": "0",
                }  # fmt: skip
                records.append(SessionRecord(row, vertices, pose, shape, translation, side))
    return records


def _write_registrations(
    folder: Path, records: list[SessionRecord], model: SurfaceModel | None = None
) -> Path:
    """What ``corporeal register SESSION -o`` would have left."""
    model = model or open_model("hand")
    for record in records:
        write_record(record_path(folder, record.name), record)
    make_folder(folder)
    save_model(model, folder / "model.npz")
    named = {"name": model.name, "side": model.side, "sha256": model_digest(model)}
    content = {"format": "corporeal-registrations-1", "model": named, "options": {"unit": "mm"}}
    (folder / "manifest.json").write_text(json.dumps(content))
    return folder


def _decide(folder: Path, decisions: dict[str, str]) -> None:
    """What a curator decided."""
    lines = [json.dumps({"name": name, "decision": word, "time": 0}) for name, word in decisions.items()]
    (folder / "decisions.jsonl").write_text("".join(f"{line}\n" for line in lines))


@pytest.fixture(scope="session")
def made_records():
    return _made_records


@pytest.fixture(scope="session")
def write_registrations():
    return _write_registrations


@pytest.fixture(scope="session")
def decide():
    return _decide


@pytest.fixture
def browser():
    """Opens a page of a real Chromium: ``with browser(profile, width, height) as page``."""
    if not CHROMIUM.exists():
        pytest.skip(f"{CHROMIUM} is not installed (Debian's package chromium)")
    from playwright import sync_api

    @contextlib.contextmanager
    def opened(profile: Path, width: int, height: int) -> Iterator:
        with sync_api.sync_playwright() as playwright:
            context = playwright.chromium.launch_persistent_context(
                str(profile), executable_path=str(CHROMIUM), headless=True, args=CHROMIUM_FLAGS,
                viewport={"width": width, "height": height},
            )  # fmt: skip
            try:
                yield context.pages[0]
            finally:
                # A test may have killed it.
                with contextlib.suppress(sync_api.Error):
                    context.close()

    return opened
