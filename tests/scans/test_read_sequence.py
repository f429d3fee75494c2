import pytest

from corporeal.scans.files import ScanFileError, read_sequence


def test_a_folder_of_scans_of_any_known_kind_is_a_sequence(tmp_path):
    for name in ("2.stl", "10.glb", "1.ply", "notes.md"):
        (tmp_path / name).write_bytes(b"")
    assert [frame.name for frame in read_sequence(tmp_path).frames] == ["1", "2", "10"]


def test_a_folder_without_scans_is_refused_as_a_scan_file_is(tmp_path):
    with pytest.raises(ScanFileError, match=r"holds no sequence\.json"):
        read_sequence(tmp_path)
