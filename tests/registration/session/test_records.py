"""Records: small, exact to half a step, the same bytes each time, and damage is noticed."""

import time
from dataclasses import replace

import numpy as np
import pytest

from corporeal.registration.session.files import read_decisions, read_record, read_records, write_record
from corporeal.registration.session.records import (
    FoundLandmarks,
    RecordError,
    SessionRecord,
    decode_record,
    encode_record,
)


def _record(rng, name="s01_p01_right", extent=0.2):
    row = {"name": name, "scan": f"{name}.ply", "status": "ok", "seconds": {"total": 1.5}}
    return SessionRecord(
        row=row,
        vertices=rng.uniform(-extent, extent, (2931, 3)) + 0.4,
        pose=rng.standard_normal((16, 3)),
        shape=rng.standard_normal(30),
        translation=rng.standard_normal(3),
        side="right",
    )


@pytest.mark.parametrize("extent", [0.01, 0.2, 1.0])
def test_a_record_comes_back_to_half_a_step(rng, extent):
    record = _record(rng, extent=extent)
    back = decode_record(encode_record(record), "it")
    assert np.abs(back.vertices - record.vertices).max() <= 0.5e-5 + 1e-12
    np.testing.assert_array_equal(back.pose, record.pose.astype(np.float32))
    np.testing.assert_array_equal(back.shape, record.shape.astype(np.float32))
    np.testing.assert_array_equal(back.translation, record.translation)
    assert back.row == record.row and back.side == "right" and back.name == "s01_p01_right"


def test_landmarks_are_kept_to_the_last_bit_with_and_without_a_registration(rng):
    found = FoundLandmarks("hand_21", ("a", "b"), rng.standard_normal((2, 3)), rng.random(2), 0.9)
    whole = replace(_record(rng), landmarks=found)
    for record in (whole, SessionRecord(whole.row, landmarks=found)):
        back = decode_record(encode_record(record), "it").landmarks
        np.testing.assert_array_equal(back.positions, found.positions)
        np.testing.assert_array_equal(back.sigmas, found.sigmas)
        assert (back.set_name, back.names, back.right_probability) == ("hand_21", ("a", "b"), 0.9)


def test_random_vertices_of_a_hand_stay_under_40_kb(rng):
    assert len(encode_record(_record(rng))) < 40_000


def test_a_failed_scan_is_its_row_alone():
    row = {"name": "a", "scan": "a.ply", "status": "failed", "reason": "empty"}
    back = decode_record(encode_record(SessionRecord(row)), "it")
    assert not back.is_registered and back.row == row and back.pose is None


def test_bytes_do_not_know_the_time(rng, monkeypatch):
    record = _record(rng)
    first = encode_record(record)
    monkeypatch.setattr(time, "time", lambda: 2e9)
    assert encode_record(record) == first


def test_every_truncation_and_flipped_bit_is_noticed_or_harmless(rng):
    content = encode_record(_record(rng))
    whole = decode_record(content, "it")
    for length in rng.integers(0, len(content), 40):
        with pytest.raises(RecordError, match=r"it: damaged.*register its session again"):
            decode_record(content[:length], "it")
    for place in rng.integers(0, len(content), 200):
        changed = bytearray(content)
        changed[place] ^= 1 << int(rng.integers(8))
        try:
            back = decode_record(bytes(changed), "it")
        except RecordError:
            continue
        # Bytes that no reader looks at (dates, attributes) may change; what is read may not.
        assert back.row == whole.row
        np.testing.assert_array_equal(back.vertices, whole.vertices)


def test_folder_of_records_is_read_in_order_and_skips_nothing(rng, tmp_path):
    for name in ("b", "a"):
        write_record(tmp_path / "records" / f"{name}.npz", _record(rng, name))
    assert [record.name for record in read_records(tmp_path)] == ["a", "b"]
    (tmp_path / "records" / "c.npz").write_bytes(b"PK")
    with pytest.raises(RecordError, match=r"c\.npz"):
        read_records(tmp_path)
    with pytest.raises(RecordError, match="holds no records"):
        read_records(tmp_path / "records")
    with pytest.raises(RecordError, match=r"d\.npz: cannot be read"):
        read_record(tmp_path / "d.npz")


def test_last_decision_wins_and_a_cut_off_line_is_dropped(tmp_path):
    lines = [("a", "accept"), ("b", "reject"), ("a", "reject"), ("b", "undo"), ("c", "accept")]
    text = "".join(f'{{"name": "{name}", "decision": "{decision}", "time": 0}}\n' for name, decision in lines)
    (tmp_path / "decisions.jsonl").write_text(text + '{"name": "a", "dec')
    assert read_decisions(tmp_path) == {"a": "reject", "c": "accept"}
