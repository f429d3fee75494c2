"""Fingers are the hand's, the rest is the body's, and the seam between them is smooth."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import scipy.sparse as sp
import torch
from scipy.spatial.transform import Rotation

from corporeal.model.jacobian import evaluate
from corporeal.model.merging.errors import MergeError
from corporeal.model.merging.merge import MergeOptions, degrees_of_freedom, merge_hands
from corporeal.model.merging.seam import seam_jump
from corporeal.model.mirror import mirror_model, mirror_pose
from corporeal.model.pose import FullPose

NONE = np.zeros(3)


@pytest.fixture(scope="module")
def merged(arms, hand):
    return merge_hands(arms, hand)


def _vertices(model, pose, shape=()):
    return evaluate(model, np.asarray(shape, dtype=float), pose, NONE).vertices


def _random_pose(model, rng, scale=0.4):
    return scale * rng.standard_normal((model.joint_count, 3))


def test_the_meshes_are_found_to_be_the_same(merged, arms, hand):
    for side, placement in merged.placements.items():
        assert placement.method == "same topology" and placement.largest < 1e-9
        wrist = arms.joint_regressor[arms.joint_names.index(f"{side}_wrist")] @ arms.template
        laid = placement.from_hand @ (hand.template * ([1, 1, 1] if side == "right" else [-1, 1, 1]))
        np.testing.assert_allclose(laid + wrist, arms.template[placement.vertices], atol=1e-5)


def test_weights_and_regressor_are_shares(merged):
    model = merged.model
    assert (model.skinning_weights >= 0).all()
    np.testing.assert_allclose(model.skinning_weights.sum(axis=1), 1, atol=1e-12)
    np.testing.assert_allclose(np.asarray(model.joint_regressor.sum(axis=1)).ravel(), 1, atol=1e-12)


def test_beyond_the_hands_it_is_the_body(merged, arms, rng):
    beyond = np.setdiff1d(
        np.arange(arms.vertex_count), np.concatenate([p.vertices for p in merged.placements.values()])
    )
    assert len(beyond) > 300
    for _ in range(3):
        pose, shape = _random_pose(arms, rng), rng.standard_normal(2)
        ours, own = (_vertices(model, pose, shape)[beyond] for model in (merged.model, arms))
        np.testing.assert_allclose(ours, own, atol=1e-12)


@pytest.mark.parametrize("side", ["right", "left"])
def test_fingers_are_the_hand_models(merged, arms, hand, rng, side):
    """Where the forearm has no say: the hand model moved rigidly by the wrist, correctives included."""
    model, own = merged.model, hand if side == "right" else mirror_model(hand)
    wrist, elbow = (model.joint_names.index(f"{side}_{name}") for name in ("wrist", "elbow"))
    pose = np.zeros((model.joint_count, 3))
    turns = 0.5 * rng.standard_normal((hand.joint_count, 3))
    pose[wrist] = turns[0]
    for k in range(1, hand.joint_count):
        pose[model.joint_names.index(f"{side}_{hand.joint_names[k]}")] = turns[k]
    placement = merged.placements[side]
    posed = placement.from_hand @ _vertices(own, turns)
    shift = (
        evaluate(model, np.zeros(0), pose, NONE).joints[wrist]
        - evaluate(own, np.zeros(0), turns, NONE).joints[0]
    )
    # The seam's fade ends 60 mm in, some 30 mm beyond the wrist; elbow weights reach to the wrist.
    free = (model.skinning_weights[placement.vertices, elbow] == 0) & (
        arms.template[placement.vertices, 0] * (-1 if side == "right" else 1) > 0.65
    )
    assert free.sum() > 2000
    np.testing.assert_allclose(
        _vertices(model, pose)[placement.vertices][free], (posed + shift)[free], atol=1e-9
    )


def test_mirror_symmetry_is_kept(merged, rng):
    model = merged.model
    pose = FullPose(torch.tensor(_random_pose(model, rng)[None]))
    image = model(None, mirror_pose(pose, model)).vertices[0].numpy()
    expected = model(None, pose).vertices[0].numpy()[model.mirror_vertices] * [-1, 1, 1]
    np.testing.assert_allclose(image, expected, atol=1e-9)


def test_the_shapes_are_the_bodys(merged, arms, rng):
    shape = rng.standard_normal(2)
    pose = np.zeros((arms.joint_count, 3))
    np.testing.assert_allclose(_vertices(merged.model, pose, shape), _vertices(arms, pose, shape), atol=1e-12)


def test_the_seam_is_smooth_and_the_fade_makes_it_so(merged, arms, hand):
    smooth = seam_jump(arms, merged.model, merged.seam, poses=30)
    hard = merge_hands(arms, hand, options=MergeOptions(seam_width=0.0))
    # The arms hang on blurred weights without correctives: the two skinnings differ more than real ones.
    assert smooth < 1.5e-3
    assert smooth < seam_jump(arms, hard.model, merged.seam, poses=30)


def test_the_paper_s_degrees_of_freedom(merged, arms, hand):
    assert degrees_of_freedom(merged.model) == 66 + 12
    assert len(merged.model.block("left_hand").components) == 6
    full = merge_hands(arms, hand, options=MergeOptions(hand_components=None)).model
    assert degrees_of_freedom(full) == 66 + 90


def test_fewer_joints_a_vertex_on_request(merged, arms, hand, rng):
    assert (merged.model.skinning_weights > 0).sum(axis=1).max() > 3
    few = merge_hands(arms, hand, options=MergeOptions(most_joints=3)).model
    assert (few.skinning_weights > 0).sum(axis=1).max() == 3
    np.testing.assert_allclose(few.skinning_weights.sum(axis=1), 1, atol=1e-12)
    pose = _random_pose(arms, rng, 0.3)
    assert 1e3 * np.linalg.norm(_vertices(few, pose) - _vertices(merged.model, pose), axis=1).mean() < 0.3


def test_landmarks_come_along(merged, hand):
    sets = merged.model.landmarks
    name = "hand_21_mediapipe"
    model = merged.model
    pose = np.zeros((model.joint_count, 3))
    posed = evaluate(model, np.zeros(0), pose, NONE)
    joint = model.joint_names.index("left_index2")
    found = sets[f"left_{name}"].weights @ np.concatenate([posed.vertices, posed.joints])
    tips = dict(zip(sets[f"left_{name}"].names, found, strict=True))
    assert len(tips) == 21 and all(label.startswith("left_") for label in tips)
    assert min(np.linalg.norm(point - posed.joints[joint]) for point in tips.values()) < 1e-9


@pytest.mark.slow
def test_another_mesh_is_joined_by_closest_points(merged, arms, hand, rng):
    """The same surface with its vertices slid within 0.3 mm: nearly the same merged model."""
    slid = hand.replace(template=hand.template + 1e-4 * rng.standard_normal(hand.template.shape))
    flipped = slid.faces.copy()
    shared = np.flatnonzero(np.isin(flipped, flipped[0]).sum(axis=1) == 2)[0]
    only_first = np.setdiff1d(flipped[0], flipped[shared])[0]
    only_second = np.setdiff1d(flipped[shared], flipped[0])[0]
    edge = np.intersect1d(flipped[0], flipped[shared])
    flipped[0], flipped[shared] = [only_first, edge[0], only_second], [only_first, only_second, edge[1]]
    other = merge_hands(arms, slid.replace(faces=flipped))
    assert {placement.method for placement in other.placements.values()} == {"closest points"}
    assert np.abs(other.model.skinning_weights.sum(axis=1) - 1).max() < 1e-9
    pose = _random_pose(arms, rng, 0.3)
    apart = np.linalg.norm(_vertices(other.model, pose) - _vertices(merged.model, pose), axis=1)
    assert 1e3 * np.median(apart) < 0.2 and 1e3 * apart.mean() < 0.5


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda arms, hand: (hand, hand), "the body comes first"),
        (lambda arms, hand: (arms, arms), "is not a single hand"),
        (lambda arms, hand: (arms, hand, hand), "the hand of the other side"),
        (lambda arms, hand: (arms, hand.replace(template=1e3 * hand.template)), "are both in metres"),
        (
            lambda arms, hand: (
                arms,
                hand.replace(template=hand.template @ Rotation.from_euler("x", 90, degrees=True).as_matrix()),
            ),
            "share zero pose and axes",
        ),
        (lambda arms, hand: (arms, hand.replace(side="left")), "share zero pose and axes"),
        (
            lambda arms, hand: (arms.replace(joint_names=tuple(f"j{k}" for k in range(52))), hand),
            "has no joint 'left_wrist'",
        ),
    ],
)
def test_what_does_not_fit_is_refused(arms, hand, change, words):
    with pytest.raises(MergeError, match=words):
        merge_hands(*change(arms, hand))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda ids: ids[:-1], "for a hand of"),
        (lambda ids: np.concatenate([ids[:-1], ids[:1]]), "twice"),
        (lambda ids: ids + 10_000_000, "but the body has"),
    ],
)
def test_wrong_vertex_lists_are_refused(merged, arms, hand, change, words):
    ids = {
        side: np.asarray(sp.csr_matrix(placement.from_body).argmax(axis=1)).ravel()
        for side, placement in merged.placements.items()
    }
    again = merge_hands(arms, hand, vertices=ids)
    assert again.placements["left"].method == "given"
    np.testing.assert_array_equal(again.model.skinning_weights, merged.model.skinning_weights)
    with pytest.raises(MergeError, match=words):
        merge_hands(arms, hand, vertices=ids | {"left": change(ids["left"])})
    with pytest.raises(MergeError, match="none for the left hand"):
        merge_hands(arms, hand, vertices={"right": ids["right"]})


def test_a_hand_without_correctives_leaves_none(arms, hand):
    plain = hand.replace(pose_directions=np.zeros((hand.vertex_count, 3, 0)))
    assert not merge_hands(arms, plain).model.has_correctives
    assert dataclasses.asdict(MergeOptions())["hand_components"] == 6
