"""Fingers in the wrong pose are found in the scan; those that lie in it are left alone."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from corporeal.fitting.finger_search import FingerSearch
from corporeal.fitting.frame_data import FramePoints, HandFaces
from corporeal.fitting.frame_fit import FrameFitter, FrameStart, HandsAsked
from corporeal.fitting.options import TrackingOptions
from corporeal.geometry.closest_points import SurfaceTree
from corporeal.geometry.normals import face_normals, vertex_normals
from corporeal.geometry.topology import open_sides
from corporeal.model.files import open_model
from corporeal.terms.model_fields import ModelFields
from corporeal.terms.surface_to_scan import ScanSurface


@pytest.fixture(scope="module")
def body():
    model = open_model("body")
    return model.replace(shape_directions=np.zeros((model.vertex_count, 3, 0)))


@pytest.fixture(scope="module")
def search(body):
    faces = HandFaces.of_model(body).masks["right_hand"]
    return FingerSearch.of_block(body, body.block("right_hand"), faces)


def _vector(body, pose):
    return np.concatenate([np.zeros(3), pose.ravel()])


def _scan(body, vertices):
    normals = face_normals(vertices, body.faces)
    return ScanSurface(SurfaceTree(vertices, body.faces), normals, open_sides(body.faces))


def _bent(body, pose, bend):
    """Middle, ring and little finger closed as recorded fists are."""
    fist = body.block("right_hand").mixture.means
    joints = list(body.block("right_hand").joints)
    most = fist[np.abs(fist).sum(axis=1).argmax()].reshape(-1, 3)
    bent = pose.copy()
    bent[joints[3:12]] = bend * most[3:12]
    return bent


def test_fingers_are_chains_from_the_palm(body, search):
    assert [len(finger) for finger in search.fingers] == [3] * 5
    for finger in search.fingers:
        assert body.parents[finger[0]] == body.joint_names.index("right_wrist")
        assert [int(body.parents[joint]) for joint in finger[1:]] == list(finger[:-1])


def test_straight_fingers_are_found_from_a_fist(body, search, rng):
    fields, straight = ModelFields(body, shape_count=0), np.zeros((body.joint_count, 3))
    true = fields.evaluated(_vector(body, straight)).vertices
    scan, points = _scan(body, true), true + 5e-4 * rng.standard_normal(true.shape)
    wrong = _vector(body, _bent(body, straight, 1.0))
    vertices = fields.evaluated(wrong).vertices
    lost = search.lost(vertices, points, scan)
    found = lost.sought(fields, wrong, scan)
    after = fields.evaluated(found).vertices
    assert lost.found(lost.cost_of(after, scan)) and not lost.found(lost.cost_of(vertices, scan))
    before_mm, after_mm = (
        1e3 * np.linalg.norm(surface - true, axis=1)[search.hand].mean() for surface in (vertices, after)
    )
    assert before_mm > 10 and after_mm < 0.3 * before_mm
    moved = np.flatnonzero(np.abs((found - wrong)[3:].reshape(-1, 3)).max(axis=1))
    assert set(moved.tolist()) <= set(body.block("right_hand").joints)


def test_fingers_in_their_scan_and_hands_without_one_are_left(body, search):
    fields, straight = ModelFields(body, shape_count=0), np.zeros((body.joint_count, 3))
    true = fields.evaluated(_vector(body, straight)).vertices
    near = fields.evaluated(_vector(body, _bent(body, straight, 0.05))).vertices
    assert search.lost(near, true, _scan(body, true)) is None
    gone = true[~search.hand]
    assert search.lost(near, gone, _scan(body, true)) is None


def test_of_a_hand_that_is_open_less_is_forgiven(body, search):
    """Fingers 5 mm off: what webs may do to a fist they do not do where much of the hand is seen."""
    fields, straight = ModelFields(body, shape_count=0), np.zeros((body.joint_count, 3))
    true = fields.evaluated(_vector(body, straight)).vertices
    off = fields.evaluated(_vector(body, _bent(body, straight, 0.08))).vertices
    scan, few = _scan(body, true), np.concatenate([true[~search.hand], true[search.hand][::40]])
    assert 4.5e-3**2 < search.cost(off, true[search.hand], scan) < 6e-3**2
    assert 4.5e-3**2 < search.lost(off, true, scan).cost < 6e-3**2
    assert search.lost(off, few, scan) is None


def test_fingers_in_one_another_cost(body, search):
    fields, pose = ModelFields(body, shape_count=0), np.zeros((body.joint_count, 3))
    true = fields.evaluated(_vector(body, pose)).vertices
    scan = _scan(body, true)
    apart = search.cost(true, true[search.hand], scan)
    rest = body.joint_regressor @ body.template
    index, middle = (search.fingers[number][0] for number in (0, 1))
    # The whole index finger is carried to the middle one; points on it are explained as before.
    on_index = body.skinning_weights[:, list(search.fingers[0])].sum(axis=1) > 0.5
    moved = true + np.where(on_index[:, None], rest[middle] - rest[index], 0.0)
    assert apart < 1e-9
    assert search.cost(moved, moved[search.hand], scan) > (6e-3) ** 2


def _in_the_chest(body, search, true):
    """The posed body with its hand, as it is, carried to the middle of the chest."""
    chest = (body.joint_regressor @ body.template)[body.joint_names.index("spine3")]
    return true + np.where(search.hand[:, None], chest - true[search.hand].mean(axis=0), 0.0)


def test_a_hand_in_the_body_is_lost_however_little_is_seen_of_it(body, search):
    fields, pose = ModelFields(body, shape_count=0), np.zeros((body.joint_count, 3))
    true = fields.evaluated(_vector(body, pose)).vertices
    within = _in_the_chest(body, search, true)
    scan = _scan(body, true)
    cost = search.cost(within, within[search.hand], scan)
    assert cost > 3 * (20e-3) ** 2  # all of it deeper than a thumb is thick
    some = np.concatenate([true[~search.hand], true[search.hand][:5] + 0.005])
    about = some + (within - true)[search.hand][0] * (np.arange(len(some)) >= (~search.hand).sum())[:, None]
    assert search.lost(true, some, scan) is None
    assert search.lost(within, about, scan).cost > 3 * (20e-3) ** 2


def test_points_between_hand_and_body_are_only_in_part_the_hands(body, search):
    fields, pose = ModelFields(body, shape_count=0), np.zeros((body.joint_count, 3))
    true = fields.evaluated(_vector(body, pose)).vertices
    own = true[search.hand][::50]
    np.testing.assert_array_equal(search.own_shares(true, own, np.zeros(len(own))), 1.0)
    others = true[~search.hand & (body.skinning_weights[:, 0] > 0.9)][:5]
    np.testing.assert_array_equal(search.own_shares(true, others, np.full(5, 0.01)), 0.0)
    normals = face_normals(true, body.faces)
    beside = true[body.faces].mean(axis=1)[:1] + 0.01 * normals[:1]
    share = search.own_shares(true, beside, np.array([0.02]))
    assert share[0] == pytest.approx(0.01**2 / (0.01**2 + 0.02**2), rel=0.05)


class _Misled:
    """A body in its zero pose, a fit that began with another right hand, and how far that hand is off."""

    def __init__(self, body, search, begin):
        self.fitter, self.zero = FrameFitter(body, TrackingOptions()), np.zeros((body.joint_count, 3))
        self.hand, self.true = search.hand, self.fitter.fields.evaluated(_vector(body, self.zero)).vertices
        self.points = FramePoints(self.true, vertex_normals(self.true, body.faces), 1e-4)
        self.start = FrameStart(_vector(body, begin), first=True, back=_scan(body, self.true))
        self.vector = self.fitter.fit(self.points, self.start, self.fitter.options.first).state.parameters

    def off(self, vector):
        vertices = self.fitter.fields.evaluated(vector).vertices
        return 1e3 * np.linalg.norm(vertices - self.true, axis=1)[self.hand].mean()

    def asked(self, asked):
        return self.fitter.with_fingers(self.points, self.vector, self.start, asked)


_RIGHT, _NONE = np.array([False, True]), np.zeros(2, dtype=bool)


@pytest.mark.slow
def test_fingers_that_took_each_others_places_are_begun_anew(body, search):
    """A fist, turned by 70 degrees, is laid onto stretched fingers: the descent mixes them up."""
    turned = _bent(body, np.zeros((body.joint_count, 3)), 1.0)
    turned[body.joint_names.index("right_wrist"), 0] = np.deg2rad(70)
    misled = _Misled(body, search, turned)
    assert misled.off(misled.vector) > 15
    assert misled.off(misled.asked(HandsAsked(_RIGHT, _RIGHT, _NONE, misled.zero))) < 1
    nothing = misled.asked(HandsAsked(_NONE, _NONE, _NONE, misled.zero))
    np.testing.assert_array_equal(nothing, misled.vector)


@pytest.mark.slow
def test_a_hand_that_is_back_turned_about_its_forearm_is_righted(body, search):
    """It stands turned: whether a descent leaves it so hangs on the processor's rounding."""
    before = np.zeros((body.joint_count, 3))
    before[body.joint_names.index("right_wrist"), 0] = np.deg2rad(85)
    misled = _Misled(body, search, before)
    misled.vector = _vector(body, before)
    assert misled.off(misled.vector) > 15
    assert misled.off(misled.asked(HandsAsked(_NONE, _NONE, _RIGHT, before))) < 1
    alone = open_model("hand")
    faces = HandFaces.of_model(alone).masks["hand"]
    assert FingerSearch.of_block(alone, alone.block("hand"), faces).forearm is None


def test_what_the_rest_of_the_body_explains_is_no_reason_to_lay_a_hand_there(body, search):
    """A hand folded over its forearm lies in what bulges 16 mm out of that; a few points are the hand's."""
    fields, true = ModelFields(body, shape_count=0), np.zeros((body.joint_count, 3))
    folded = true.copy()
    folded[search.wrist] = np.deg2rad(150) * np.array([0.0, 1.0, 0.0])
    straight, wrong = (fields.evaluated(_vector(body, pose)).vertices for pose in (true, folded))
    away, _ = cKDTree(straight[~search.hand]).query(wrong[search.hand])
    bulge = wrong[search.hand][(away > 0.0155) & (away < 0.018)]
    points = np.concatenate([bulge, straight[search.hand][:: len(wrong) // len(bulge)]])
    # Either hand lies in the scan, so that points alone decide.
    vertices = np.concatenate([straight, wrong])
    faces = np.concatenate([body.faces, body.faces + len(straight)])
    scan = ScanSurface(SurfaceTree(vertices, faces), face_normals(vertices, faces), open_sides(faces))
    assert len(bulge) > 50
    assert search.compared(straight, wrong, points, scan).for_ones > 0
