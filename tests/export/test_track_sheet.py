"""The contact sheet of a track: where things are drawn, and that frames without scan or fit are drawn too."""

import numpy as np
import pytest
from PIL import Image

from corporeal.export.track_sheet import SheetFrame, SheetPicture, write_track_sheet
from corporeal.model.files import open_model

NONE = np.zeros((0, 3))


@pytest.fixture(scope="module")
def hand():
    return open_model("hand")


def _picture(hand, *, points=NONE, scan_faces=None, fit=True, error=0.0):
    errors = np.full(len(points), error)
    vertices = hand.template if fit else NONE
    return SheetPicture(
        points, scan_faces, errors, vertices, hand.faces, np.array([0.0, -1, 0]), np.array([-1.0, 0, 0])
    )


def _drawn(path, hand, *frames):
    write_track_sheet(path, "a title", frames)
    return np.asarray(Image.open(path).convert("RGB")).astype(int)


def _blue(picture):
    return (picture[..., 2] - picture[..., 0]) > 40


def _skin(picture):
    return (picture[..., 0] - picture[..., 2]) > 30


@pytest.mark.parametrize("is_cloud", [False, True])
def test_the_scan_is_left_and_the_fit_right(hand, tmp_path, is_cloud):
    faces = None if is_cloud else hand.faces
    whole = _picture(hand, points=hand.template, scan_faces=faces)
    page = _drawn(tmp_path / "a" / "sheet.png", hand, SheetFrame(whole, (), "0000: ok"))
    scan, fit = page[58:378, 12:232], page[58:378, 232:452]
    assert _blue(scan).mean() > 0.1 and not _blue(fit).any()
    assert _skin(fit).mean() > 0.1 and not _skin(scan).any()
    # Under one camera: where the fit is, there is scan. Points reach beyond the outline by their radius.
    assert _blue(scan)[_skin(fit)].mean() > 0.95
    assert (_blue(scan) == _skin(fit)).mean() > (0.85 if is_cloud else 0.95)


def test_a_large_distance_is_red(hand, tmp_path):
    whole = _picture(hand, points=hand.template, scan_faces=hand.faces, error=12.0)
    scan = _drawn(tmp_path / "sheet.png", hand, SheetFrame(whole, (), "0000"))[58:378, 12:232]
    assert _skin(scan).mean() > 0.1 and not _blue(scan).any()


def test_frames_without_scan_or_fit_have_their_place_and_say_why(hand, tmp_path):
    frames = [
        SheetFrame(_picture(hand, points=hand.template, scan_faces=hand.faces), (), "0000: ok"),
        SheetFrame(_picture(hand, fit=False), (), "0001: failed", "a very long reason " * 20),
        SheetFrame(_picture(hand), (_picture(hand),) * 2, "0002: ok"),
        SheetFrame(_picture(hand, points=hand.template, fit=False), (), "0003: failed"),
        SheetFrame(_picture(hand), (), "0004: ok"),
    ]
    page = _drawn(tmp_path / "sheet.png", hand, *frames)
    second, third = page[58:378, 464:904], page[58:508, 916:1356]
    assert not _blue(second).any() and not _skin(second).any()
    assert _skin(third[:320]).any() and _skin(third[320:450]).any()
    reason = page[378:430, 464:904]
    assert ((reason[..., 0] - reason[..., 1]) > 60).any()
    assert _skin(page[520:, 12:452]).any()  # the fifth, in the second row


def test_nothing_to_draw_is_an_error(tmp_path):
    with pytest.raises(ValueError, match="nothing to draw"):
        write_track_sheet(tmp_path / "sheet.png", "t", [])
    assert not (tmp_path / "sheet.png").exists()
