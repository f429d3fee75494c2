"""The file of registered hands gives back what was packed into it, and holds the whole session."""

import importlib.util
import itertools
import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from corporeal.atomic import write_bytes
from corporeal.learning.training_set import training_set
from corporeal.model.files import open_model
from corporeal.model.jacobian import evaluate
from corporeal.registration.session.files import DECISIONS, MANIFEST, record_path, write_record
from corporeal.registration.session.model_digest import model_digest
from corporeal.registration.session.records import SessionRecord

ASSETS = Path(__file__).parents[3] / "assets"
FILE = ASSETS / "registered_hands.npz"
SOME = 5


@pytest.fixture(scope="module")
def tool():
    spec = importlib.util.spec_from_file_location("registered_hands", ASSETS / "registered_hands.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Three accepted registrations of both sides and a rejected one."""
    rng = np.random.default_rng(3)
    folder = tmp_path_factory.mktemp("registered")
    for number, side in enumerate(("left", "right", "left", "right")):
        model = open_model("soft_hand", side=side)
        pose, shape, place = (
            0.2 * rng.standard_normal((model.joint_count, 3)),
            rng.standard_normal(model.shape_count),
            rng.standard_normal(3),
        )
        surface = evaluate(model, shape, pose, place).vertices
        row = {
            "name": f"scan{number}",
            "status": "failed" if number == 3 else "ok",
            "side": side,
            "subject": f"s{number}",
            "protocol_pose": "flat",
            "scan": f"/somewhere/scan{number}.ply",
            "s2m_mm": {"mean": 0.2},
        }
        vertices = surface + 1e-3 * rng.standard_normal(surface.shape)
        record = SessionRecord(row, vertices, pose, shape, place, side)
        write_record(record_path(folder, row["name"]), record)
    right = open_model("soft_hand")
    manifest = {
        "format": "corporeal-registrations-1",
        "model": {"name": "soft_hand", "sha256": model_digest(right), "side": "right"},
        "round": 1,
        "versions": {},
    }
    write_bytes(folder / MANIFEST, json.dumps(manifest).encode())
    return folder


def test_what_was_accepted_comes_back_to_half_a_step(tool, folder, tmp_path):
    (tmp_path / "packed.npz").write_bytes(tool.packed(folder))
    manifest, records = tool.unpacked(tmp_path / "packed.npz")
    found = {record.name: record for record in records}
    assert manifest["model"]["name"] == "soft_hand"
    assert sorted(found) == ["scan0", "scan1", "scan2"]
    for name, record in found.items():
        before = tool.read_records(folder)[int(name[-1])]
        # The folder's own records are rounded to ten micrometres.
        assert np.abs(record.vertices - before.vertices).max() < tool.STEP / 2 + 1e-5
        np.testing.assert_array_equal(record.pose, before.pose)
        assert record.side == before.side and record.row["scan"] == f"{name}.ply"


def test_the_curator_decides(tool, folder, tmp_path):
    reviewed = tmp_path / "reviewed"
    shutil.copytree(folder, reviewed)
    decided = [{"name": "scan1", "decision": "reject"}, {"name": "scan3", "decision": "accept"}]
    lines = [json.dumps(line | {"time": 0}) for line in decided]
    (reviewed / DECISIONS).write_text("".join(f"{line}\n" for line in lines))
    (tmp_path / "packed.npz").write_bytes(tool.packed(reviewed))
    _, records = tool.unpacked(tmp_path / "packed.npz")
    assert {record.name: record.row["status"] for record in records} == dict.fromkeys(
        ("scan0", "scan2", "scan3"), "ok"
    )


def test_a_model_of_the_box_is_laid_onto_what_another_registered(tool, folder, tmp_path):
    other = tmp_path / "other"
    shutil.copytree(folder, other)
    manifest = json.loads((other / MANIFEST).read_text())
    manifest["model"] |= {"name": "hand", "sha256": "learned in the first round"}
    (other / MANIFEST).write_text(json.dumps(manifest))
    with pytest.raises(SystemExit, match="not in the box; give one of it with --start"):
        tool.packed(other)
    (tmp_path / "packed.npz").write_bytes(tool.packed(other, "start_hand"))
    manifest, records = tool.unpacked(tmp_path / "packed.npz")
    assert manifest["model"]["sha256"] == model_digest(open_model("start_hand"))
    before = {record.name: record for record in tool.read_records(folder)}
    for record in records:
        known = before[record.name]
        assert np.abs(record.vertices - known.vertices).max() < tool.STEP / 2 + 1e-5
        lying = evaluate(
            open_model("start_hand", side=record.side), record.shape, record.pose, record.translation
        ).vertices
        left_alone = evaluate(
            open_model("start_hand", side=record.side), known.shape, known.pose, known.translation
        ).vertices
        off, off_before = (np.square(one - record.vertices).mean() for one in (lying, left_alone))
        # A millimetre of noise stays, what the correctives of the two differ by goes.
        assert off < off_before and np.sqrt(3 * off) < 3e-3


def test_byte_planes_hold_any_16_bits(tool):
    numbers = np.array([0, 1, -1, 255, -256, 2**15 - 1, -(2**15) + 1])
    np.testing.assert_array_equal(tool.of_byte_planes(tool.byte_planes(numbers)), numbers)


def test_the_file_is_of_31_people_and_fits_the_model_of_the_box(tool):
    _, records = tool.unpacked(FILE)
    some = list(itertools.islice(records, SOME))
    training = training_set(some, open_model("soft_hand"))
    assert len(training) == SOME
    assert np.ptp(training.vertices, axis=1).max() < 0.3
    with np.load(FILE) as archive:
        rows = json.loads(archive["rows"].tobytes())
    assert len(rows) > 1500 and len({row["subject"] for row in rows}) == 31
    assert {row["side"] for row in rows} == {"left", "right"}
