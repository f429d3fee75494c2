import json

import numpy as np
import pytest

from corporeal.scans.formats.landmarks import LandmarkFileError, read_landmarks

POINTS = {"wrist": [0.0, 1.5, -2e-3], "index_tip": [1.0, 2.0, 3.0]}


@pytest.mark.parametrize(
    ("ending", "text"),
    [
        ("json", json.dumps(POINTS)),
        ("json", json.dumps({"names": list(POINTS), "points": list(POINTS.values())})),
        ("csv", "wrist,0,1.5,-2e-3\nindex_tip,1,2,3\n"),
        ("CSV", "name,x,y,z\n\nwrist, 0, 1.5, -0.002\nindex_tip,1,2,3"),
    ],
)
def test_all_forms_give_the_same_landmarks(tmp_path, ending, text):
    path = tmp_path / f"marks.{ending}"
    path.write_text(text)
    landmarks = read_landmarks(path)
    assert list(landmarks) == list(POINTS)
    for name, point in POINTS.items():
        np.testing.assert_array_equal(landmarks[name], point)


@pytest.mark.parametrize(
    ("ending", "text", "message"),
    [
        ("json", "{", "no JSON"),
        ("json", "[1, 2]", "expected"),
        ("json", "{}", "no landmark"),
        ("json", '{"wrist": [1, 2]}', "'wrist' needs three finite"),
        ("json", '{"wrist": [1, 2, NaN]}', "'wrist' needs three finite"),
        ("json", '{"wrist": 4}', "no list of three"),
        ("json", '{"wrist": ["a", "b", "c"]}', "no list of three"),
        ("json", '{"names": ["wrist"], "points": []}', "one length"),
        ("json", "[" * 100_000, "no JSON"),
        ("csv", "wrist,1,2\n", "'wrist' needs three finite"),
        ("csv", "wrist,1,2,three\n", "no list of three"),
        ("csv", "", "no landmark"),
        ("json", '{"wrist": [1, 2, 3], "wrist": [4, 5, 6]}', "twice"),
        ("csv", "wrist,1,2,3\nwrist,4,5,6\n", "twice"),
    ],
)
def test_wrong_files_are_named_with_what_was_expected(tmp_path, ending, text, message):
    path = tmp_path / f"marks.{ending}"
    path.write_text(text)
    with pytest.raises(LandmarkFileError, match=message) as caught:
        read_landmarks(path)
    assert path.name in str(caught.value)


def test_files_that_cannot_be_read(tmp_path):
    with pytest.raises(LandmarkFileError, match="cannot be read"):
        read_landmarks(tmp_path / "absent.json")
    binary = tmp_path / "binary.json"
    binary.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(LandmarkFileError, match="cannot be read"):
        read_landmarks(binary)
