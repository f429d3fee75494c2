import re

import pytest

from corporeal.view.player_panel import STATUS_COLOURS, PlayerWords, problems_html, strip_html, words_html
from corporeal.view.track import FrameRow


def rows_of(letters):
    words = {"o": "ok", "d": "doubtful", "f": "failed"}
    return [
        FrameRow(f"{i:04d}", words[letter], "" if letter == "o" else f"why {letter}", 1.0 + i % 3)
        for i, letter in enumerate(letters)
    ]


@pytest.mark.parametrize("count", [1, 7, 300, 301, 5000])
def test_the_strip_has_no_more_bars_than_can_be_seen_and_hides_no_frame_that_failed(count):
    letters = ["o"] * count
    letters[count // 2] = "f"
    strip = strip_html(rows_of(letters), 0)
    bars = re.findall(r"fill='(#\w+)'", strip)
    assert len(bars) == min(count, 300)
    assert bars.count(STATUS_COLOURS["failed"]) == 1
    assert bars.index(STATUS_COLOURS["failed"]) == pytest.approx(len(bars) / 2, abs=1)


def test_the_strip_marks_where_it_stands():
    rows = rows_of("oooo")
    assert "left:calc(12.50% - 1px)" in strip_html(rows, 0)
    assert "left:calc(87.50% - 1px)" in strip_html(rows, 3)


def test_problems_are_links_to_the_first_frames_of_stretches():
    text = problems_html(rows_of("oddofo"))
    assert re.findall(r'data-go="(\d+)"', text) == ["1", "4"]
    assert "0001 to 0002" in text and "2 doubtful, 1 failed" in text
    assert "all frames are ok" in problems_html(rows_of("ooo"))
    many = problems_html(rows_of("od" * 50))
    assert many.count("data-go=") == 8 and "and 42 more" in many


def test_words_say_all_and_cannot_be_broken_out_of():
    row = FrameRow("<b>'0\"", "doubtful", "<script>", None, (("left hand", 0.931),))
    words = PlayerWords("<i>", 3, 9, 0.5, row, True, "scan<", 2, "&amp")
    text = words_html(words)
    for raw in ("<script>", "<i>", "<b>'0", "scan<<", "&amp<"):
        assert raw not in text
    assert "data-frame='3' data-count='9' data-scan='2' data-playing='1'" in text
    assert "93 %" in text and "4 of 9" in text and STATUS_COLOURS["doubtful"] in text
