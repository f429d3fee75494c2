"""Records of tracked frames on disk: every bit comes back, damage is said."""

import dataclasses

import numpy as np
import pytest

from corporeal.fitting.files import (
    FrameRecord,
    TrackFileError,
    frame_path,
    load_subject_template,
    read_frame,
    read_story,
    save_subject_template,
    update_story,
    write_frame,
)
from corporeal.fitting.subject_template import SubjectTemplate, personal_model
from corporeal.fitting.track import TrackedFrame, TrackState
from corporeal.model.files import open_model


def _record(rng, **changes):
    pose, place = rng.standard_normal((16, 3)), rng.standard_normal(3)
    turned, moved = rng.standard_normal((16, 3)), rng.standard_normal(3)
    state = TrackState(pose + 1, place + 1, True, turned, moved, np.array([4]))
    frame = TrackedFrame(
        "0007", "doubtful", "far: 4.2 mm", pose, place, {"mean": 0.1 + 0.2}, {"total": 1 / 3}, {"seen": 0.5}
    )  # fmt: skip
    return FrameRecord(dataclasses.replace(frame, **changes), state, "ab" * 32, (2**40, 2**62))


def _assert_same(one, two):
    for field in dataclasses.fields(one):
        first, second = getattr(one, field.name), getattr(two, field.name)
        if isinstance(first, np.ndarray):
            assert first.tobytes() == second.tobytes()
        else:
            assert first == second, field.name


def test_a_record_comes_back_to_the_last_bit_and_its_bytes_repeat(rng, tmp_path):
    record, path = _record(rng), frame_path(tmp_path, "0007")
    write_frame(path, record)
    found = read_frame(path)
    _assert_same(record.frame, found.frame)
    _assert_same(record.state, found.state)
    assert (found.sha256, found.stamp) == (record.sha256, record.stamp)
    content = path.read_bytes()
    write_frame(path, found)
    assert path.read_bytes() == content and len(content) < 20_000


def test_free_vertices_come_back_within_half_a_step(rng, tmp_path):
    """The next write gives the same bytes: what was rounded once stays."""
    path = tmp_path / "f.npz"
    for size in (3e-3, 2.5):  # the second does not fit into the narrow numbers
        offsets = size * rng.uniform(-1, 1, (18_056, 3))
        write_frame(path, _record(rng, offsets=offsets))
        content, found = path.read_bytes(), read_frame(path)
        assert np.abs(found.frame.offsets - offsets).max() <= 25e-6 * (1 + 1e-9)
        write_frame(path, found)
        assert path.read_bytes() == content
        assert size > 1 or len(content) < 100_000


def test_a_frame_without_a_scan_has_neither_distances_nor_a_file(rng, tmp_path):
    lost = _record(rng, s2m_mm=None, status="failed", signals={})
    write_frame(tmp_path / "f.npz", dataclasses.replace(lost, sha256=None, stamp=None))
    found = read_frame(tmp_path / "f.npz")
    assert (found.frame.s2m_mm, found.sha256, found.stamp) == (None, None, None)


def test_damage_is_said_wherever_it_is(rng, tmp_path):
    path = tmp_path / "f.npz"
    write_frame(path, _record(rng))
    content = path.read_bytes()
    for cut in (0, 10, len(content) // 2, len(content) - 30):
        path.write_bytes(content[:cut])
        with pytest.raises(TrackFileError, match=r"f\.npz: damaged"):
            read_frame(path)
    np.savez(path, pose=np.zeros((16, 3)))
    with pytest.raises(TrackFileError, match="is missing 'name"):
        read_frame(path)
    with pytest.raises(FileNotFoundError):
        read_frame(tmp_path / "none.npz")


def test_a_template_comes_back_to_the_last_bit(rng, tmp_path):
    hand = open_model("hand")
    personal = personal_model(hand, hand.template + 1e-3 * rng.standard_normal(hand.template.shape))
    pose, place = rng.standard_normal((16, 3)), rng.standard_normal(3)
    template = SubjectTemplate(personal, rng.standard_normal(5), ("0", "2"), {"1": "blurred"}, pose, place)
    assert read_story(tmp_path) is None
    save_subject_template(tmp_path, template, {"made_from": {"a": 1}})
    found = load_subject_template(tmp_path)
    for name in ("shape", "start_pose", "start_translation"):
        assert getattr(found, name).tobytes() == getattr(template, name).tobytes()
    assert found.model.template.tobytes() == personal.template.tobytes()
    assert (found.used, found.rejected) == (("0", "2"), {"1": "blurred"})
    update_story(tmp_path, {"made_from": {"a": 2}})
    assert read_story(tmp_path)["made_from"] == {"a": 2} and read_story(tmp_path)["used"] == ["0", "2"]
    (tmp_path / "template.npz").write_bytes(b"PK")
    with pytest.raises(TrackFileError, match="use --restart"):
        load_subject_template(tmp_path)
    with pytest.raises(TrackFileError, match=r"holds no template\.json"):
        load_subject_template(tmp_path / "elsewhere")
