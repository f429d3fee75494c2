import json

import pytest

from corporeal.scans.formats.sequence import FORMAT, SequenceFileError, read_sequence

_SUFFIXES = (".ply", ".obj")


def _write(folder, **content):
    (folder / "sequence.json").write_text(json.dumps({"format": FORMAT} | content))


def test_a_plain_folder_is_a_sequence_in_the_order_of_its_numbers(tmp_path):
    for name in ("f10.ply", "f9.PLY", "f100.obj", "notes.txt"):
        (tmp_path / name).write_bytes(b"")
    sequence = read_sequence(tmp_path, _SUFFIXES)
    assert [frame.name for frame in sequence.frames] == ["f9", "f10", "f100"]
    assert sequence.fps == 60 and sequence.unit == "auto" and "60" in sequence.notes[0]


def test_a_list_says_order_rate_unit_and_subject_and_files_need_not_exist(tmp_path):
    frames = [{"name": "b", "file": "scans/b.ply"}, {"name": "a", "file": "scans/a.ply"}]
    _write(tmp_path, name="walk", fps=30, unit="mm", subject="s01", frames=frames)
    sequence = read_sequence(tmp_path, _SUFFIXES)
    assert (sequence.name, sequence.fps, sequence.unit, sequence.subject) == ("walk", 30, "mm", "s01")
    assert [frame.path for frame in sequence.frames] == [tmp_path / "scans/b.ply", tmp_path / "scans/a.ply"]
    assert sequence.notes == ()


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ({"format": "x"}, "format"),
        ({"frames": []}, "at least one"),
        ({"frames": [3]}, "object for every frame"),
        ({"frames": [{"name": "a", "file": "../a.ply"}]}, "must lie in"),
        ({"frames": [{"name": "../a", "file": "a.ply"}]}, "cannot be a name"),
        ({"frames": [{"name": "a", "file": "a.ply"}] * 2}, "2 frames are named 'a'"),
        ({"frames": [{"name": "a", "file": "a.ply"}], "fps": 0}, "fps"),
        ({"frames": [{"name": "a", "file": "a.ply"}], "fps": True}, "fps"),
        ({"frames": [{"name": "a", "file": "a.ply"}], "unit": "inch"}, "inch"),
        ({"frames": [{"name": "a", "file": "a.ply"}], "subject": 3}, "subject"),
    ],
)
def test_what_breaks_the_format_is_refused_with_the_reason(tmp_path, content, words):
    _write(tmp_path, **content)
    with pytest.raises(SequenceFileError, match=words):
        read_sequence(tmp_path, _SUFFIXES)


def test_no_sequence_at_all_is_refused(tmp_path):
    with pytest.raises(SequenceFileError, match=r"holds no sequence\.json"):
        read_sequence(tmp_path, _SUFFIXES)
    (tmp_path / "sequence.json").write_text("{")
    with pytest.raises(SequenceFileError, match=r"sequence\.json"):
        read_sequence(tmp_path, _SUFFIXES)
