"""Model files: what goes in comes out, the five layouts, and left hands."""

import os
import zipfile

import numpy as np
import pytest
import scipy.sparse as sp

from corporeal.model import files
from corporeal.model.files import ModelFileError, load_model, open_model, save_model
from corporeal.model.formats.families import FAMILIES
from corporeal.model.landmarks import LandmarkSet
from corporeal.model.mirror import mirror_model
from corporeal.model.statistics import PoseBlock, PoseMixture
from corporeal.model.surface_model import CutPlane, SurfaceModel

NAMES = [family.name for family in FAMILIES]


def full_model(rng, shape_count=12, expression_count=3) -> SurfaceModel:
    """A small model that uses every field."""
    V, K = 30, 4
    joints = (1, 2, 3)
    D = 9
    covariances = rng.normal(size=(2, D, D))
    weights, regressor = rng.random((V, K)), sp.random(K, V, 0.3, random_state=3).toarray() + np.eye(K, V)
    return SurfaceModel(
        name="tøy",
        template=rng.normal(size=(V, 3)),
        faces=np.stack([rng.permutation(V)[:3] for _ in range(40)]),
        shape_directions=rng.normal(size=(V, 3, shape_count)),
        expression_directions=rng.normal(size=(V, 3, expression_count)),
        pose_directions=rng.normal(size=(V, 3, 9 * (K - 1))),
        joint_regressor=sp.csr_matrix(regressor / regressor.sum(axis=1, keepdims=True)),
        skinning_weights=weights / weights.sum(axis=1, keepdims=True),
        parents=np.array([-1, 0, 1, 0]),
        joint_names=("root", "upper", "lower", "thumb"),
        side="right",
        parts={"tip": np.array([3, 1, 2]), "palm": np.arange(10)},
        pose_blocks=(
            PoseBlock(
                "hand",
                joints,
                rng.normal(size=D),
                rng.normal(size=(5, D)),
                rng.random(5),
                mean_included=False,
                mixture=PoseMixture(np.array([0.25, 0.75]), rng.normal(size=(2, D)), covariances),
                limits=rng.normal(size=(D, 2)),
            ),
        ),
        landmarks={
            "tips": LandmarkSet.from_surface(
                ["a", "b"], np.array([[0, 1, 2], [3, 4, 5]]), np.full((2, 3), 1 / 3), V, K
            )
        },
        mirror_vertices=rng.permutation(V),
        mirror_joints=rng.permutation(K),
        cut=CutPlane(0, rng.normal(size=3), np.array([0.0, 1.0, 0.0])),
        notes={"licence": "CC0-1.0", "source": "this test"},
    )


def assert_same_model(one: SurfaceModel, other: SurfaceModel, skip=()):
    plain = {"name", "side", "joint_names", "notes"}
    arrays = {
        "template", "faces", "shape_directions", "expression_directions", "pose_directions",
        "skinning_weights", "parents", "mirror_vertices", "mirror_joints",
    }  # fmt: skip
    for name in plain - set(skip):
        assert getattr(one, name) == getattr(other, name), name
    for name in arrays - set(skip):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)
    assert abs(one.joint_regressor - other.joint_regressor).nnz == 0
    assert list(one.parts) == list(other.parts)
    for name in one.parts:
        np.testing.assert_array_equal(one.parts[name], other.parts[name])
    assert list(one.landmarks) == list(other.landmarks)
    for name, landmarks in one.landmarks.items():
        assert landmarks.names == other.landmarks[name].names
        assert abs(landmarks.weights - other.landmarks[name].weights).nnz == 0
    assert [b.name for b in one.pose_blocks] == [b.name for b in other.pose_blocks]
    for mine, theirs in zip(one.pose_blocks, other.pose_blocks, strict=True):
        assert_same_block(mine, theirs)
    assert (one.cut is None) == (other.cut is None)
    if one.cut is not None:
        assert one.cut.joint == other.cut.joint
        np.testing.assert_array_equal([one.cut.point, one.cut.normal], [other.cut.point, other.cut.normal])


def assert_same_block(mine: PoseBlock, theirs: PoseBlock):
    assert (mine.joints, mine.mean_included) == (theirs.joints, theirs.mean_included)
    for name in ("mean", "components", "component_deviations", "limits"):
        np.testing.assert_array_equal(getattr(mine, name), getattr(theirs, name))
    assert (mine.mixture is None) == (theirs.mixture is None)
    if mine.mixture is not None:
        for name in ("weights", "means", "covariances"):
            np.testing.assert_array_equal(getattr(mine.mixture, name), getattr(theirs.mixture, name))


@pytest.mark.parametrize("ending", [".npz", ".pkl"])
@pytest.mark.parametrize("counts", [(0, 0), (7, 0), (12, 0), (310, 0), (5, 3), (12, 3), (300, 100)])
def test_native_files_give_back_the_same_model(counts, ending, tmp_path, rng):
    model = full_model(rng, *counts)
    save_model(model, tmp_path / f"a{ending}")
    assert_same_model(model, load_model(tmp_path / f"a{ending}"))


def test_a_bare_model_comes_back(tmp_path, rng):
    model = full_model(rng).replace(
        side=None, parts={}, pose_blocks=(), landmarks={}, mirror_vertices=None, mirror_joints=None, cut=None,
        notes={}, pose_directions=np.zeros((30, 3, 0)), name="",
    )  # fmt: skip
    save_model(model, tmp_path / "a.npz")
    assert_same_model(model, load_model(tmp_path / "a.npz"))


def test_the_same_model_gives_the_same_bytes(tmp_path, rng, monkeypatch):
    model = full_model(rng)
    turned = model.replace(shape_directions=np.asfortranarray(model.shape_directions))
    save_model(model, tmp_path / "a.npz")
    monkeypatch.setattr("time.time", lambda: 0.0)
    save_model(turned, tmp_path / "b.npz")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


@pytest.mark.parametrize(("precision", "relative"), [("float32", 6e-8), ("float16", 5e-4)])
def test_lower_precision_rounds_the_directions_as_stated_and_nothing_else(precision, relative, tmp_path, rng):
    model = full_model(rng)
    save_model(model, tmp_path / "a.npz", precision=precision)
    loaded = load_model(tmp_path / "a.npz")
    directions = ("shape_directions", "expression_directions", "pose_directions")
    for name in directions:
        exact = getattr(model, name)
        error = np.abs(getattr(loaded, name) - exact)
        assert 0 < (error / np.abs(exact)).max() < relative * 1.0001 + 1e-7 / np.abs(exact).max()
    assert_same_model(model, loaded, skip=directions)


def test_files_hold_no_pickles_and_numpy_reads_them(tmp_path, rng):
    model = full_model(rng)
    save_model(model, tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz", allow_pickle=False) as archive:
        assert all(archive[key] is not None for key in archive.files)
        np.testing.assert_array_equal(archive["v_template"], model.template)
        np.testing.assert_array_equal(archive["kintree_table"][0], model.parents)


def test_a_failed_write_leaves_the_old_file_and_no_other(tmp_path, rng, monkeypatch):
    path = tmp_path / "a.npz"
    save_model(full_model(rng), path)
    before = path.read_bytes()
    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", lambda *names: (_ for _ in ()).throw(OSError(28, "No space left")))
        with pytest.raises(ModelFileError, match="No space left"):
            save_model(full_model(rng).replace(name="other"), path)
    assert path.read_bytes() == before
    assert [file.name for file in tmp_path.iterdir()] == ["a.npz"]


def test_more_expressions_than_the_layout_holds_are_refused(tmp_path, rng):
    with pytest.raises(ModelFileError, match=r"a\.npz.*301 shape and 3 expression"):
        save_model(full_model(rng, 301, 3), tmp_path / "a.npz")


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("a.obj", {}, "unknown ending"),
        ("taken/a.npz", {}, "cannot be written"),
        ("a.npz", {"layout": "official"}, "no official family"),
    ],
)
def test_what_cannot_be_written_is_said(name, options, message, tmp_path, rng):
    (tmp_path / "taken").write_text("a file where a folder should be")
    with pytest.raises(ModelFileError, match=message):
        save_model(full_model(rng), tmp_path / name, **options)
    assert [file.name for file in tmp_path.iterdir()] == ["taken"]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "cannot be read"),
        (b"", "holds no model"),
        (b"ply\nformat ascii 1.0\n", "holds no model"),
        (b"PK\x03\x04 and then nothing", "holds no model"),
        (b"cposix\nsystem\n(S'true'\ntR.", r"posix\.system.*nothing was run"),
        (b"\x80\x04]\x94.", "a list, expected a dictionary"),
    ],
)
def test_what_is_no_model_file_is_said(content, message, tmp_path):
    path = tmp_path / "a.npz"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ModelFileError, match=f"a.npz.*{message}"):
        load_model(path)


def test_archives_that_claim_too_much_are_refused_before_they_are_unpacked(tmp_path, monkeypatch):
    path = tmp_path / "bomb.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("v_template.npy", bytes(5_000_000))
    monkeypatch.setattr("corporeal.model.formats.archive.SIZE_LIMIT", 4_000_000)
    monkeypatch.setattr(zipfile.ZipFile, "read", lambda *_: pytest.fail("unpacked"))
    with pytest.raises(ModelFileError, match="claim 5000000 bytes"):
        load_model(path)


@pytest.mark.parametrize("writer", ["write_npz", "write_plain_pickle", "write_chumpy_pickle"])
@pytest.mark.parametrize("name", NAMES)
def test_official_files_are_read_exactly(official, name, writer, tmp_path, rng):
    arrays = official.official_arrays(name, rng)
    # The family and the container come from the content: the file's name lies.
    model = load_model(getattr(official, writer)(tmp_path / "smplx_left.npz", arrays))
    family = official.FAMILY_OF_NAME[name]
    assert (model.name, model.joint_names) == (name, family.joint_names)
    assert model.side == ("right" if name == "mano" else None)
    directions = np.concatenate([model.shape_directions, model.expression_directions], axis=2)
    for got, key in (
        (model.template, "v_template"),
        (model.faces, "f"),
        (directions, "shapedirs"),
        (model.pose_directions, "posedirs"),
        (model.joint_regressor.toarray(), "J_regressor"),
        (model.skinning_weights, "weights"),
    ):
        np.testing.assert_array_equal(got, arrays[key])
        assert got.flags.c_contiguous
        assert got.dtype == (np.int64 if key == "f" else np.float64)
    assert model.expression_count == (10 if family.expressions else 0)


@pytest.mark.parametrize("name", NAMES)
def test_pose_blocks_hold_every_joint_but_the_root_once(official, name, tmp_path, rng):
    arrays = official.official_arrays(name, rng)
    model = load_model(official.write_npz(tmp_path / "a.npz", arrays))
    joints = [joint for block in model.pose_blocks for joint in block.joints]
    assert sorted(joints) == list(range(1, model.joint_count))
    for block, suffix in (("hand", ""), ("left_hand", "l"), ("right_hand", "r")):
        if f"hands_mean{suffix}" not in arrays:
            continue
        found = model.block(block)
        assert found.mean_included
        np.testing.assert_array_equal(found.mean, arrays[f"hands_mean{suffix}"])
        np.testing.assert_array_equal(found.components, arrays[f"hands_components{suffix}"])
        np.testing.assert_allclose(found.component_deviations, arrays[f"hands_coeffs{suffix}"].std(axis=0))


def test_unknown_deviations_are_said_to_be_unknown(official, tmp_path, rng):
    arrays = official.official_arrays("smplh", rng)
    del arrays["hands_coeffsl"]
    model = load_model(official.write_npz(tmp_path / "a.npz", arrays))
    assert (model.block("left_hand").component_deviations == 1).all()
    assert "unknown" in model.notes["statistics"]
    assert (model.block("right_hand").component_deviations != 1).all()


def test_families_are_trees_with_the_joints_of_the_originals():
    counts = {family.name: len(family.parents) for family in FAMILIES}
    assert counts == {"mano": 16, "smpl": 24, "smplh": 52, "smplx": 55, "flame": 5}
    assert len({family.parents for family in FAMILIES}) == len(FAMILIES)
    for family in FAMILIES:
        assert len(set(family.joint_names)) == len(family.joint_names)
        assert family.parents[0] == -1
        assert all(0 <= parent < joint for joint, parent in enumerate(family.parents) if joint)


@pytest.mark.parametrize(
    ("name", "official_list"), [("smplh", "SMPLH_JOINT_NAMES"), ("smplx", "JOINT_NAMES")]
)
def test_joint_names_are_those_of_smplx(name, official_list):
    theirs = getattr(pytest.importorskip("smplx.joint_names"), official_list)
    ours = next(family.joint_names for family in FAMILIES if family.name == name)
    renamed = [n.replace("pinky", "little").replace("_smplhf", "") for n in theirs[: len(ours)]]
    assert list(ours) == renamed


@pytest.mark.parametrize(
    ("columns", "split"), [(400, (300, 100)), (150, (100, 50)), (20, (10, 10)), (10, (10, 0))]
)
def test_shape_and_expression_are_divided_as_the_families_do(official, columns, split, tmp_path, rng):
    arrays = official.official_arrays("flame", rng, (60, 90, columns))
    model = load_model(official.write_npz(tmp_path / "a.npz", arrays))
    assert (model.shape_count, model.expression_count) == split
    np.testing.assert_array_equal(model.expression_directions, arrays["shapedirs"][:, :, split[0] :])


def test_a_count_of_columns_that_cannot_be_divided_is_refused(official, tmp_path, rng):
    path = official.write_npz(tmp_path / "a.npz", official.official_arrays("smplx", rng, (60, 90, 33)))
    with pytest.raises(ModelFileError, match="33 columns"):
        load_model(path)


def test_an_unknown_tree_is_refused_with_what_was_found(official, tmp_path, rng):
    arrays = official.official_arrays("mano", rng)
    arrays["kintree_table"][0, 5] = 0
    with pytest.raises(ModelFileError, match=r"16 joints is of no known family.*hands_components"):
        load_model(official.write_npz(tmp_path / "a.npz", arrays))


def test_a_missing_key_is_named_with_what_was_found(official, tmp_path, rng):
    arrays = official.official_arrays("smpl", rng)
    del arrays["posedirs"]
    with pytest.raises(ModelFileError, match=r"'posedirs' is missing .the file holds: J_regressor"):
        load_model(official.write_npz(tmp_path / "a.npz", arrays))


def test_a_sparse_matrix_pickled_into_an_archive_is_read(official, tmp_path, rng):
    arrays = official.official_arrays("mano", rng)
    wrapped = np.array(None, dtype=object)
    wrapped[()] = sp.csc_matrix(arrays["J_regressor"])
    np.savez(tmp_path / "a.npz", **arrays | {"J_regressor": wrapped})
    model = load_model(tmp_path / "a.npz")
    np.testing.assert_array_equal(model.joint_regressor.toarray(), arrays["J_regressor"])


@pytest.mark.parametrize("name", ["mano", "smplh", "smplx", "flame"])
def test_the_official_layout_loses_only_what_it_has_no_keys_for(official, name, tmp_path, rng):
    model = load_model(official.write_npz(tmp_path / "a.npz", official.official_arrays(name, rng)))
    save_model(model, tmp_path / "b.npz", layout="official")
    with np.load(tmp_path / "b.npz") as archive:
        assert not [key for key in archive.files if key.startswith("corporeal")]
    loaded = load_model(tmp_path / "b.npz")
    for block in loaded.pose_blocks:
        np.testing.assert_allclose(block.component_deviations, model.block(block.name).component_deviations)
    assert_same_model(
        model.replace(pose_blocks=(), landmarks={}), loaded.replace(pose_blocks=(), landmarks={})
    )
    for key, landmarks in model.landmarks.items():
        assert abs(landmarks.weights - loaded.landmarks[key].weights).max() < 1e-15


def test_models_of_the_package_open_on_both_sides(tmp_path, rng, monkeypatch):
    save_model(full_model(rng), tmp_path / "toy.npz")
    folder = tmp_path / "open_models"
    folder.mkdir()
    (tmp_path / "toy.npz").rename(folder / "toy.npz")
    monkeypatch.setattr(files.resources, "files", lambda _: tmp_path)
    right, left = open_model("toy"), open_model("toy", side="left")
    assert (right.side, left.side) == ("right", "left")
    assert_same_model(mirror_model(right), left)
    with pytest.raises(ModelFileError, match="foot"):
        open_model("foot")


def test_messages_of_several_lines_become_one(official, tmp_path, rng):
    path = official.write_npz(tmp_path / "a.npz", official.official_arrays("smpl", rng))
    header = b"\x93NUMPY\x01\x00" + (20_000).to_bytes(2, "little") + b" " * 20_000
    with zipfile.ZipFile(path) as old, zipfile.ZipFile(tmp_path / "b.npz", "w") as new:
        for name in old.namelist():
            new.writestr(name, header if name == "f.npy" else old.read(name))
    with pytest.raises(ModelFileError, match="Header info length") as caught:
        load_model(tmp_path / "b.npz")
    assert "\n" not in str(caught.value)
