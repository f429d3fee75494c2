"""Official layouts with random content: SMPL and MANO become SMPL+H, SMPL-X gets other hands."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from corporeal.cli.main import main
from corporeal.model.files import load_model, save_model
from corporeal.model.formats.families import FAMILIES, family_of_tree
from corporeal.model.formats.vertex_lists import read_vertex_lists
from corporeal.model.jacobian import evaluate
from corporeal.model.merging.merge import MergeOptions, merge_hands
from corporeal.model.mirror import mirror_model
from corporeal.model.pose import FullPose

HAND_SIZE, BODY_SIZE = 60, 260
JOINTS = {
    "smplh": {"body_pose": 21, "left_hand_pose": 15, "right_hand_pose": 15},
    "smplx": {
        "body_pose": 21, "jaw_pose": 1, "leye_pose": 1, "reye_pose": 1, "left_hand_pose": 15,
        "right_hand_pose": 15,
    },
}  # fmt: skip


@pytest.fixture
def pair(official, rng, tmp_path):
    """Makes a body file of a family with a MANO hand's template in it, and the list of its vertices."""

    def made(family: str):
        hand_arrays = official.official_arrays("mano", rng, (HAND_SIZE, 90, 10))
        columns = 20 if family == "smplx" else 10
        arrays = official.official_arrays(family, rng, (BODY_SIZE, 500, columns))
        ids = {"left": np.arange(10, 10 + HAND_SIZE), "right": 100 + rng.permutation(HAND_SIZE)}
        for side, sign in (("left", -1), ("right", 1)):
            laid = hand_arrays["v_template"] * [sign, 1, 1] + [-0.5 * sign, 0, 0]
            arrays["v_template"][ids[side]] = laid
        # Of its hands' vertices the body has wrists and elbows; of fingers only these.
        names = next(one for one in FAMILIES if one.name == family).joint_names
        fingers = [k for k, name in enumerate(names) if name[-1] in "123" and "spine" not in name]
        others = np.setdiff1d(np.arange(BODY_SIZE), np.concatenate(list(ids.values())))
        arrays["weights"][np.ix_(others, fingers)] = 0
        arrays["weights"][arrays["weights"].sum(axis=1) == 0, 0] = 1
        arrays["weights"] /= arrays["weights"].sum(axis=1, keepdims=True)
        body_path = official.write_npz(tmp_path / f"{family.upper()}_BODY.npz", arrays)
        hand_path = official.write_npz(tmp_path / "MANO_RIGHT.npz", hand_arrays)
        lists = tmp_path / "ids.npz"
        np.savez(lists, left_hand=ids["left"], right_hand=ids["right"])
        return body_path, hand_path, lists

    return made


def test_smpl_and_mano_become_smplh(pair):
    body_path, hand_path, lists = pair("smpl")
    body, hand = load_model(body_path), load_model(hand_path)
    model = merge_hands(body, hand, vertices=read_vertex_lists(lists)).model
    family = family_of_tree(model.parents)
    assert family is not None and family.name == "smplh"
    assert model.joint_names == family.joint_names
    right = read_vertex_lists(lists)["right"]
    row = model.joint_regressor[model.joint_names.index("right_ring2"), right].toarray().ravel()
    expected = hand.joint_regressor[hand.joint_names.index("ring2")].toarray().ravel()
    np.testing.assert_array_equal(row, expected)
    np.testing.assert_allclose(model.skinning_weights.sum(axis=1), 1, atol=1e-6)


@pytest.mark.parametrize("family", ["smpl", "smplx"])
def test_the_hand_root_is_shared_as_the_body_shares(pair, family):
    """Fingers have the hand's weights; what is left goes to the body's joints in the body's proportion."""
    body_path, hand_path, lists = pair(family)
    body, hand, ids = load_model(body_path), load_model(hand_path), read_vertex_lists(lists)
    merged = merge_hands(body, hand, vertices=ids, options=MergeOptions(seam_width=0.0)).model
    names = merged.joint_names
    fingers = [names.index(f"right_{name}") for name in hand.joint_names[1:]]
    rows = merged.skinning_weights[ids["right"]]
    np.testing.assert_allclose(rows[:, fingers], hand.skinning_weights[:, 1:], atol=1e-6)
    wrist, elbow = names.index("right_wrist"), names.index("right_elbow")
    own = body.skinning_weights[ids["right"]]
    own_wrist = own[:, body.joint_names.index("right_wrist")]
    if family == "smpl":
        own_wrist = own_wrist + own[:, body.joint_names.index("right_hand")]
    own_elbow = own[:, body.joint_names.index("right_elbow")]
    np.testing.assert_allclose(rows[:, wrist] * own_elbow, rows[:, elbow] * own_wrist, atol=1e-6)


@pytest.mark.parametrize("family", ["smpl", "smplx"])
def test_beyond_the_hands_it_is_the_body(pair, rng, family):
    body_path, hand_path, lists = pair(family)
    body, hand, ids = load_model(body_path), load_model(hand_path), read_vertex_lists(lists)
    body = body.replace(pose_directions=body.pose_directions[:, :, :0])
    merged = merge_hands(body, hand, vertices=ids).model
    others = np.setdiff1d(np.arange(BODY_SIZE), np.concatenate(list(ids.values())))
    pose = np.zeros((merged.joint_count, 3))
    common = [name for name in merged.joint_names if name in body.joint_names and name[-1] not in "123"]
    for name in common:
        pose[merged.joint_names.index(name)] = 0.4 * rng.standard_normal(3)
    own = np.stack(
        [pose[merged.joint_names.index(name)] if name in common else np.zeros(3) for name in body.joint_names]
    )
    shape = rng.standard_normal(body.shape_count)
    first = evaluate(body, shape, own, np.zeros(3)).vertices[others]
    second = evaluate(merged, shape, pose, np.zeros(3)).vertices[others]
    # Of a body without fingers the hand joints' weights went to the wrists, which do not turn against them.
    np.testing.assert_allclose(first, second, atol=1e-9)


@pytest.mark.parametrize(("family", "result"), [("smpl", "smplh"), ("smplx", "smplx")])
def test_smplx_poses_the_merged_file_to_the_same_vertices(pair, rng, tmp_path, family, result):
    smplx = pytest.importorskip("smplx")
    body_path, hand_path, lists = pair(family)
    merged = merge_hands(
        load_model(body_path), load_model(hand_path), vertices=read_vertex_lists(lists)
    ).model
    path = tmp_path / f"{result.upper()}_NEUTRAL.pkl"
    save_model(merged, path, layout="official")
    options = {
        "use_pca": False,
        "flat_hand_mean": True,
        "dtype": torch.float64,
        "ext": "pkl",
        "num_betas": 10,
    }
    module = {"smplh": smplx.SMPLH, "smplx": smplx.SMPLX}[result](str(path), **options)
    module.vertex_joint_selector.extra_joints_idxs = torch.zeros(0, dtype=torch.long)
    pose = torch.tensor(0.4 * rng.standard_normal((1, merged.joint_count, 3)))
    shape = torch.tensor(rng.standard_normal((1, 10)))
    arguments, first = {"global_orient": pose[:, 0], "betas": shape}, 1
    for name, count in JOINTS[result].items():
        arguments[name] = pose[:, first : first + count].reshape(1, -1)
        first += count
    expected = module(**arguments).vertices.detach().numpy()
    stored = load_model(path)
    found = stored(shape, FullPose(pose)).vertices.numpy()
    np.testing.assert_allclose(found, expected, atol=1e-6)
    np.testing.assert_allclose(found, merged(shape, FullPose(pose)).vertices.numpy(), atol=1e-6)


def test_the_command(pair, tmp_path, capsys):
    body_path, hand_path, lists = pair("smpl")
    output, result = tmp_path / "out/smplh.npz", tmp_path / "out.json"
    arguments = ["merge", str(body_path), str(hand_path), "-o", str(output), "--vertices", str(lists)]
    assert main([*arguments, "--json", str(result), "--seam-poses", "3"]) == 0
    said = capsys.readouterr().err
    assert "78 degrees of freedom" in said and "right hand: 60 vertices (given)" in said
    assert load_model(output).joint_count == 52
    left = tmp_path / "MANO_LEFT.npz"
    save_model(mirror_model(load_model(hand_path)), left)
    again = tmp_path / "again.npz"
    arguments = ["merge", str(body_path), str(left), "-o", str(again), "--vertices", str(lists)]
    assert main([*arguments, "--hand-pose", "full", "--seam-poses", "1"]) == 0
    assert "156 degrees of freedom" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda a, tmp: [a[1], a[0], *a[2:]], "the body comes first"),
        (lambda a, tmp: a[:4], "give the vertices of the hands"),
        (lambda a, tmp: [*a[:3], str(tmp / "out.txt")], ".npz or .pkl"),
        (lambda a, tmp: [*a[:3], a[0]], "is a source itself"),
        (lambda a, tmp: [*a, "--seam-width", "-1"], "--seam-width"),
        (lambda a, tmp: [*a, "--hand-components", "0"], "--hand-components"),
        (lambda a, tmp: [*a, "--most-joints", "0"], "--most-joints"),
        (lambda a, tmp: [*a[:5], a[0]], "holds no 'left_hand'"),
        (lambda a, tmp: [*a[:5], str(tmp / "none.npz")], "none.npz"),
        (lambda a, tmp: [str(tmp / "none.pkl"), *a[1:]], "none.pkl"),
    ],
)
def test_wrong_calls_name_what_is_wrong(pair, tmp_path, capsys, change, words):
    body_path, hand_path, lists = pair("smpl")
    whole = [str(body_path), str(hand_path), "-o", str(tmp_path / "o.npz"), "--vertices", str(lists)]
    assert main(["merge", *change(whole, tmp_path)]) != 0
    said = capsys.readouterr().err
    assert words in said and "Traceback" not in said
    assert not (tmp_path / "o.npz").exists()
