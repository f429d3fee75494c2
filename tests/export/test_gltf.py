import dataclasses

import numpy as np
import pytest

from corporeal.export.gltf import GlbOptions, write_glb
from corporeal.export.gltf_check import GlbFile, compare_with_model, vertices_at
from corporeal.model.files import open_model
from corporeal.model.mirror import mirror_model

# The target is 0.1 mm at every key; float32 allows 0.001.
KEY_TOLERANCE_MM = 0.001


def arguments(model, rng):
    pose = 0.8 * rng.standard_normal((model.joint_count, 3))
    return {
        "shape": rng.standard_normal(model.shape_count),
        "pose": pose,
        "translation": rng.standard_normal(3),
        "expression": rng.standard_normal(model.expression_count),
    }


def written(tmp_path, model, given, **more):
    path = tmp_path / "folder" / "hand.glb"
    write_glb(path, model, **given, **more)
    return path


@pytest.mark.parametrize("kind", ["model", "dense_model", "left"])
@pytest.mark.parametrize("correctives", [True, False])
def test_the_file_gives_our_vertices_at_every_key(kind, correctives, request, rng, tmp_path):
    model = (
        mirror_model(request.getfixturevalue("model")) if kind == "left" else request.getfixturevalue(kind)
    )
    given = arguments(model, rng)
    path = written(tmp_path, model, given, correctives=correctives)
    agreement = compare_with_model(path, model, **given, correctives=correctives)
    assert len(agreement.at_keys_mm) == 11
    assert max(agreement.at_keys_mm) < KEY_TOLERANCE_MM
    assert agreement.as_opened_mm < KEY_TOLERANCE_MM
    # Between keys only the correctives (8 mm here) are bent; the joints' slerp is exact.
    assert max(agreement.between_keys_mm) < (0.1 if correctives else KEY_TOLERANCE_MM)


@pytest.mark.parametrize("side", ["right", "left"])
def test_the_open_hand(side, rng, tmp_path, khronos_validator):
    model = open_model("hand") if side == "right" else mirror_model(open_model("hand"))
    block = model.block("hand")
    pose = np.zeros((16, 3))
    pose[0], pose[1:] = (0.5, 2.5, -0.4), np.clip(
        block.mean + block.components[:15].T @ (block.component_deviations[:15] * rng.standard_normal(15)),
        block.limits[:, 0], block.limits[:, 1],
    ).reshape(15, 3)  # fmt: skip
    given = {"shape": rng.standard_normal(20), "pose": pose, "translation": np.array([0.1, 0.4, -0.2])}
    path = written(tmp_path, model, given)
    agreement = compare_with_model(path, model, **given)
    assert max(agreement.at_keys_mm) < KEY_TOLERANCE_MM
    assert max(agreement.between_keys_mm) < 0.1
    issues = khronos_validator(path)["issues"]
    assert issues["numErrors"] == issues["numWarnings"] == 0, issues["messages"]


def test_the_comparison_sees_a_wrong_file(model, rng, tmp_path):
    given = arguments(model, rng)
    path = written(tmp_path, model, given)
    for name in ("shape", "pose", "translation", "expression"):
        other = {**given, name: given[name] + 0.01}
        assert max(compare_with_model(path, model, **other).at_keys_mm) > 0.01, name
    assert max(compare_with_model(path, model, **given, correctives=False).at_keys_mm) > 0.01


def test_directions_that_are_no_targets_are_baked_in(model, rng, tmp_path):
    given = arguments(model, rng)
    options = GlbOptions(shape_targets=2, expression_targets=0, keys=5, seconds=1.0)
    path = written(tmp_path, model, given, options=options)
    glb = GlbFile.read(path)
    names = glb.document["meshes"][0]["extras"]["targetNames"]
    assert [name for name in names if not name.startswith("pose_")] == ["shape_00", "shape_01"]
    assert np.allclose(glb.key_times, [0, 0.25, 0.5, 0.75, 1])
    assert max(compare_with_model(path, model, **given).at_keys_mm) < KEY_TOLERANCE_MM


def test_shape_targets_show_the_other_shape_on_the_same_skeleton(model, rng, tmp_path):
    given = {**arguments(model, rng), "pose": np.zeros((model.joint_count, 3))}
    path = written(tmp_path, model, given)
    glb = GlbFile.read(path)
    glb.document["meshes"][0]["weights"][1] += 2.0
    before = vertices_at(GlbFile.read(path), None)
    moved = vertices_at(glb, None)
    np.testing.assert_allclose(moved - before, 2 * model.shape_directions[:, :, 1], atol=1e-6)


def test_few_corrective_targets_do(model, rng, tmp_path):
    glb = GlbFile.read(written(tmp_path, model, arguments(model, rng)))
    names = glb.document["meshes"][0]["extras"]["targetNames"]
    correctives = [name for name in names if name.startswith("pose_corrective")]
    assert 1 <= len(correctives) <= 10
    assert len(names) == len(glb.primitive["targets"]) == len(glb.document["meshes"][0]["weights"])
    weights = glb.array(glb.document["animations"][0]["samplers"][-1]["output"]).reshape(11, len(names))
    assert np.abs(weights[:, -len(correctives) :]).max() <= 1 + 1e-6
    np.testing.assert_array_equal(weights[0, -len(correctives) :], 0)


def test_joints_are_nodes_and_the_root_turns_about_its_own_joint(model, rng, tmp_path):
    given = arguments(model, rng)
    glb = GlbFile.read(written(tmp_path, model, given))
    skin = glb.document["skins"][0]
    nodes = glb.document["nodes"]
    assert [nodes[joint]["name"] for joint in skin["joints"]] == list(model.joint_names)
    names = [node["name"] for node in nodes]
    assert len(set(names)) == len(names)
    rest = model.template + model.shape_directions @ given["shape"]
    rest = rest + model.expression_directions @ given["expression"]
    root = nodes[skin["joints"][0]]["translation"]
    np.testing.assert_allclose(root, (model.joint_regressor @ rest)[0] + given["translation"], atol=1e-12)


@pytest.mark.parametrize("kind", ["model", "dense_model"])
def test_the_khronos_validator_finds_nothing(kind, request, rng, tmp_path, khronos_validator):
    model = request.getfixturevalue(kind)
    report = khronos_validator(written(tmp_path, model, arguments(model, rng)))
    issues = report["issues"]
    assert issues["numErrors"] == issues["numWarnings"] == 0, issues["messages"]
    assert report["info"]["hasMorphTargets"]
    assert report["info"]["hasSkins"]
    assert report["info"]["animationCount"] == 1


def test_the_validator_would_see_an_error(model, rng, tmp_path, khronos_validator):
    path = written(tmp_path, model, arguments(model, rng))
    broken = path.read_bytes().replace(b'"rotation":[', b'"rotation":[9', 1)
    path.write_bytes(broken[:8] + len(broken).to_bytes(4, "little") + broken[12:])
    assert khronos_validator(path)["issues"]["numErrors"] > 0


def test_a_loose_vertex_gets_a_normal_that_gltf_allows(model, rng, tmp_path, khronos_validator):
    loose = model.replace(faces=model.faces[(model.faces != 0).all(axis=1)])
    report = khronos_validator(written(tmp_path, loose, arguments(model, rng)))
    assert report["issues"]["numErrors"] == 0, report["issues"]["messages"]


def test_a_bare_model_in_the_zero_pose(model, tmp_path, khronos_validator):
    plain = model.replace(
        shape_directions=np.zeros((model.vertex_count, 3, 0)),
        expression_directions=np.zeros((model.vertex_count, 3, 0)),
    )
    given = {"shape": np.zeros(0), "pose": np.zeros((5, 3)), "translation": np.zeros(3)}
    path = written(tmp_path, plain, given)
    assert max(compare_with_model(path, plain, **given).at_keys_mm) < KEY_TOLERANCE_MM
    assert khronos_validator(path)["issues"]["numErrors"] == 0


def test_wrong_calls_are_refused_and_leave_nothing(model, rng, tmp_path):
    given = arguments(model, rng)
    path = tmp_path / "hand.glb"
    for name, value, message in (
        ("pose", given["pose"][:3], r"pose: expected \(5, 3\)"),
        ("pose", given["pose"] * np.nan, "pose: holds NaN"),
        ("pose", given["pose"] + 40, "use more keys"),
        ("shape", np.zeros(9), "shape: 9 coefficients for 4"),
        ("expression", np.zeros(9), "expression: 9 coefficients for 2"),
    ):
        with pytest.raises(ValueError, match=message):
            write_glb(path, model, **{**given, name: value})
    with pytest.raises(ValueError, match="keys: an animation needs at least 2"):
        write_glb(path, model, **given, options=dataclasses.replace(GlbOptions(), keys=1))
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_is_no_glb_is_refused(tmp_path):
    path = tmp_path / "x.glb"
    path.write_bytes(b"glTF\2\0\0\0\0\1\0\0")
    with pytest.raises(ValueError, match="not a whole GLB file"):
        GlbFile.read(path)
