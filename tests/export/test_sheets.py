import numpy as np
import pytest
import torch
from PIL import Image

from corporeal.export.component_sheet import pose_sheet, shape_sheet
from corporeal.export.corrective_sheet import CorrectiveCase, corrective_sheet
from corporeal.export.sheets import View, model_views, write_sheet
from corporeal.export.template_sheet import template_comparison
from corporeal.model.files import open_model
from corporeal.model.pose import FullPose

MARGIN, SIDE, HEADING, GAP = 12, 62, 34, 4
X, Y, Z = np.eye(3)
FRONT = View("front", -Z, X)


def cell(picture, row, column, tile, side=SIDE, title=0):
    """One tile, its upper strip (words) cut away."""
    left = MARGIN + side + column * (tile[0] + GAP)
    top = MARGIN + HEADING + title + round(row * (tile[1] + GAP))
    return picture[top + 24 : top + tile[1], left : left + tile[0]].astype(int)


def drawn(pixels):
    return np.abs(pixels - [250, 250, 249]).max(axis=-1) > 12


def test_shape_components_change_the_hand_both_ways_and_the_mean_stands_between():
    hand = open_model("hand")
    picture = shape_sheet(hand, components=5)
    assert picture.shape == (
        MARGIN + HEADING + 2 * 254 - GAP + MARGIN,
        MARGIN + SIDE + 6 * 194 - GAP + MARGIN,
        3,
    )
    assert picture.dtype == np.uint8
    np.testing.assert_array_equal(picture, shape_sheet(hand, components=5))
    mean = drawn(cell(picture, 0.5, 0, (190, 250)))
    # The first component of the asset is size: one direction has more surface than the mean, the other less.
    areas = [drawn(cell(picture, row, 1, (190, 250))).sum() for row in (0, 1)]
    assert min(areas) < 0.8 * mean.sum() < mean.sum() < 0.8 * max(areas)
    for column in range(1, 6):
        upper, lower = (drawn(cell(picture, row, column, (190, 250))) for row in (0, 1))
        assert (upper != lower).mean() > 0.005


def test_surfaces_are_whole_in_their_tiles(model):
    for picture, tile, columns in (
        (shape_sheet(model, components=4), (190, 250), 5),
        (pose_sheet(model, components=3, block="right_hand"), (150, 200), 4),
    ):
        for column in range(1, columns):
            for row in (0, 1):
                pixels = drawn(cell(picture, row, column, tile))
                assert pixels.any()
                rim = np.concatenate([pixels[-1], pixels[:, 0], pixels[:, -1]])
                assert not rim.any()


def test_a_left_hand_is_the_mirrored_sheet():
    right, left = (pose_sheet(open_model("hand", side), components=2) for side in ("right", "left"))
    for row, column in ((0, 1), (1, 1), (0, 2), (1, 2)):
        seen = drawn(cell(right, row, column, (150, 200)))
        mirrored = drawn(cell(left, row, column, (150, 200)))[:, ::-1]
        assert (seen != mirrored).mean() < 0.01


def test_wrong_numbers_of_components_are_refused(model):
    with pytest.raises(ValueError, match="expected 1 to 4, the shape directions of the model, got 5"):
        shape_sheet(model)
    with pytest.raises(
        ValueError, match="expected 1 to 3, the pose components of block 'right_hand' of the model, got 0"
    ):
        pose_sheet(model, components=0)
    with pytest.raises(ValueError, match="deviations: must be positive"):
        shape_sheet(model, components=1, deviations=0.0)
    with pytest.raises(ValueError, match="no pose block"):
        pose_sheet(model.replace(pose_blocks=()))


def test_templates_that_are_equal_look_equal_and_distances_have_colours(model):
    tile = (300, 340)
    other = model.template + [0, 0, 0.0]
    picture = template_comparison(model.template, other, model.faces, model_views(model), ("one", "two"))
    for column in range(3):
        np.testing.assert_array_equal(*(cell(picture, row, column, tile, side=0) for row in (0, 1)))
    far = model.template + [0, 0.0, 0.01]
    picture = template_comparison(
        model.template, far, model.faces, (FRONT,), reference=model.template, largest_mm=5.0
    )
    near, red = (cell(picture, row, 0, tile, side=0, title=HEADING) for row in (0, 1))
    assert near[drawn(near)].mean(axis=0).argmax() == 2
    assert red[drawn(red)].mean(axis=0).argmax() == 0
    with pytest.raises(ValueError, match="views: at least one"):
        template_comparison(model.template, far, model.faces, ())
    with pytest.raises(ValueError, match="largest_mm: must be positive"):
        template_comparison(model.template, far, model.faces, (FRONT,), largest_mm=0.0)


def case(model, rng, **changes):
    pose = 0.4 * rng.standard_normal((model.joint_count, 3))
    translation = np.array([0.3, -0.1, 0.2])
    posed = model(
        None, FullPose(torch.from_numpy(pose[None])), translation=torch.from_numpy(translation[None])
    )
    return CorrectiveCase(
        "bent", model, pose, translation, **{"registration": posed.vertices[0].numpy(), **changes}
    )


def test_the_registration_of_the_model_itself_is_its_corrected_pose(model, rng):
    tile = (200, 240)
    tube = case(model, rng)
    picture = corrective_sheet([tube, tube], FRONT)
    without, corrected, registration, _, overlay, template, offset = (
        cell(picture, 1, column, tile, side=0) for column in range(7)
    )
    np.testing.assert_array_equal(drawn(corrected), drawn(registration))
    np.testing.assert_array_equal(drawn(corrected), drawn(overlay))
    assert (drawn(without) != drawn(registration)).any()
    assert (drawn(template) != drawn(offset)).any()
    # Of two surfaces at one depth the one with the lower index is seen: here always the corrected one.
    np.testing.assert_array_equal(overlay[drawn(overlay)], corrected[drawn(corrected)])


def test_the_camera_turns_with_the_root(model, rng):
    tube = case(model, rng)
    still = tube.pose.copy()
    still[0] = 0
    vertices = model(None, FullPose(torch.from_numpy(still[None]))).vertices[0].numpy()
    unturned = CorrectiveCase("bent", model, still, np.zeros(3), vertices)
    turned, plain = (corrective_sheet([one], FRONT) for one in (tube, unturned))
    difference = np.abs(turned.astype(int) - plain.astype(int)).max(axis=-1) > 12
    assert difference.mean() < 0.01


def test_cases_that_cannot_be_shown_are_refused(model, rng):
    with pytest.raises(ValueError, match="cases: at least one"):
        corrective_sheet([], FRONT)
    with pytest.raises(ValueError, match=r"registration of 'bent' has 3 vertices, its model \d+"):
        corrective_sheet([case(model, rng, registration=np.zeros((3, 3)))], FRONT)
    plain = model.replace(pose_directions=np.zeros((model.vertex_count, 3, 0)))
    with pytest.raises(ValueError, match="'bent' has no pose correctives"):
        corrective_sheet([case(plain, rng)], FRONT)


def test_a_sheet_is_written_as_it_is(model, tmp_path):
    picture = template_comparison(model.template, model.template, model.faces, model_views(model)[:1])
    write_sheet(tmp_path / "new" / "sheet.png", picture)
    with Image.open(tmp_path / "new" / "sheet.png") as page:
        np.testing.assert_array_equal(np.asarray(page), picture)
