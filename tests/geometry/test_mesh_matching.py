"""A mesh is found in another by its triangles, whatever its shape."""

import numpy as np
import pytest

from corporeal.geometry.mesh_matching import matched_from
from corporeal.model.files import open_model


@pytest.fixture(scope="module")
def hand():
    return open_model("start_hand")


def _hidden(faces, count, rng):
    """The mesh among other triangles, its vertices and triangles renumbered, corners turned."""
    extra = 40
    place = rng.permutation(count + extra)[:count]
    others = np.setdiff1d(np.arange(count + extra), place)
    free = np.stack([others[:-2], others[1:-1], others[2:]], axis=1)[::3]
    moved = np.concatenate([place[faces], free])
    turned = np.take_along_axis(moved, (rng.integers(0, 3, (len(moved), 1)) + np.arange(3)) % 3, axis=1)
    return place, turned[rng.permutation(len(turned))]


def test_the_part_is_found(hand, rng):
    place, whole = _hidden(hand.faces, hand.vertex_count, rng)
    first = tuple(int(v) for v in place[hand.faces[0]])
    np.testing.assert_array_equal(matched_from(hand.faces, whole, first), place)


def test_another_place_is_none(hand, rng):
    place, whole = _hidden(hand.faces, hand.vertex_count, rng)
    for face in (1, 17, 400):
        corners = tuple(int(v) for v in place[hand.faces[face]])
        assert matched_from(hand.faces, whole, corners) is None
    corners = tuple(int(v) for v in place[hand.faces[0]])
    assert matched_from(hand.faces, whole, corners[1:] + corners[:1]) is None


def test_a_missing_triangle_is_noticed(hand, rng):
    place, whole = _hidden(hand.faces, hand.vertex_count, rng)
    first = tuple(int(v) for v in place[hand.faces[0]])
    lost = set(place[hand.faces[100]].tolist())
    less = whole[[set(face) != lost for face in whole.tolist()]]
    assert len(less) == len(whole) - 1
    assert matched_from(hand.faces, less, first) is None
