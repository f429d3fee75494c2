"""The list of a session: read as it is written, and refused by name where it breaks its format."""

import json

import pytest

from corporeal.scans.formats.session import SessionFileError, SessionScan, read_session

_SCAN = {"name": "a", "file": "scans/a.ply", "subject": "s", "protocol_pose": "p", "side": "left"}


def _written(folder, scans, **changes):
    content = {"format": "corporeal-session-1", "unit": "mm", "scans": scans} | changes
    (folder / "session.json").write_text(json.dumps(content))
    return folder


def test_a_list_comes_sorted_with_all_that_it_says(tmp_path):
    other = {"name": "0", "file": "0.ply"}
    session = read_session(_written(tmp_path, [_SCAN, other]), (".ply",))
    assert session.unit == "mm" and session.folder == tmp_path.resolve()
    assert session.scans == (SessionScan("0", "0.ply"), SessionScan("a", "scans/a.ply", "s", "p", "left"))


def test_a_folder_without_a_list_is_a_session_of_its_scans(tmp_path):
    for name in ("b.PLY", "a.obj", "notes.txt"):
        (tmp_path / name).touch()
    session = read_session(tmp_path, (".ply", ".obj"))
    assert session.scans == (SessionScan("a", "a.obj"), SessionScan("b", "b.PLY")) and session.unit == "auto"
    (tmp_path / "a.ply").touch()
    with pytest.raises(SessionFileError, match="2 scans are named 'a'"):
        read_session(tmp_path, (".ply", ".obj"))


@pytest.mark.parametrize(
    ("scans", "changes", "words"),
    [
        ([_SCAN], {"format": "other"}, "corporeal-session-1"),
        ([_SCAN], {"unit": "inch"}, "'inch'"),
        ([], {}, "at least one entry"),
        ([_SCAN, _SCAN], {}, "2 scans are named 'a'"),
        ([_SCAN | {"name": "../a"}], {}, "cannot be the name"),
        ([_SCAN | {"name": ".a"}], {}, "cannot be the name"),
        ([_SCAN | {"file": "../a.ply"}], {}, "must lie in the session's folder"),
        ([_SCAN | {"file": "/a.ply"}], {}, "must lie in the session's folder"),
        ([_SCAN | {"side": "both"}], {}, "unknown side 'both'"),
        ([_SCAN | {"subject": 3}], {}, "its subject must be a text"),
        (["a"], {}, "expected an object"),
    ],
)
def test_a_broken_list_is_refused_by_name(tmp_path, scans, changes, words):
    with pytest.raises(SessionFileError, match=words):
        read_session(_written(tmp_path, scans, **changes), (".ply",))


def test_damaged_json_and_a_missing_folder_are_refused(tmp_path):
    (tmp_path / "session.json").write_text('{"format": "corp')
    with pytest.raises(SessionFileError, match=r"session\.json"):
        read_session(tmp_path, (".ply",))
    with pytest.raises(SessionFileError, match="nowhere"):
        read_session(tmp_path / "nowhere", (".ply",))
