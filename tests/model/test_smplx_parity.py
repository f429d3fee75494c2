"""Our model against smplx 0.1.28 on random files of all five official layouts, and on files that we wrote."""

import dataclasses
import pickle

import numpy as np
import pytest
import torch

from corporeal.geometry.rotations import matrix_from_axis_angle
from corporeal.model.files import load_model, save_model
from corporeal.model.pose import CoefficientPose, FullPose

smplx = pytest.importorskip("smplx")

BATCH = 2
VERTEX_TOLERANCE = 1e-7  # metres: smplx adds 1e-8 to the rotation vector inside its Rodrigues formula
GRADIENT_TOLERANCE = 1e-6  # relative
FAMILIES = ["mano", "smpl", "smplh", "smplx", "flame"]

# Names of smplx's pose arguments in the order of our joints, with the number of joints of each.
POSE_ARGUMENTS = {
    "mano": {"global_orient": 1, "hand_pose": 15},
    "smpl": {"global_orient": 1, "body_pose": 23},
    "smplh": {"global_orient": 1, "body_pose": 21, "left_hand_pose": 15, "right_hand_pose": 15},
    "smplx": {
        "global_orient": 1, "body_pose": 21, "jaw_pose": 1, "leye_pose": 1, "reye_pose": 1,
        "left_hand_pose": 15, "right_hand_pose": 15,
    },
    "flame": {"global_orient": 1, "neck_pose": 1, "jaw_pose": 1, "leye_pose": 1, "reye_pose": 1},
}  # fmt: skip
CLASSES = {"mano": "MANO", "smpl": "SMPL", "smplh": "SMPLH", "smplx": "SMPLX", "flame": "FLAME"}
FILE_NAMES = {name: f"{CLASSES[name]}_NEUTRAL" for name in FAMILIES} | {"mano": "MANO_RIGHT"}


def _smplx_module(name, path, shape_count, expression_count, **options):
    """The smplx model that reads ``path``; hands take full poses to which no mean is added."""
    arguments = {
        "dtype": torch.float64, "batch_size": BATCH, "num_betas": shape_count, "ext": path.suffix[1:],
    }  # fmt: skip
    if name in ("mano", "smplh", "smplx"):
        arguments |= {"use_pca": False, "flat_hand_mean": True}
    if name in ("smplx", "flame"):
        arguments["num_expression_coeffs"] = expression_count
    if name == "flame":
        embedding = {"lmk_face_idx": np.zeros(1, dtype=np.int64), "lmk_b_coords": np.full((1, 3), 1 / 3)}
        (path.parent / "flame_static_embedding.pkl").write_bytes(pickle.dumps(embedding))
    place = path.parent if name == "flame" else path
    module = getattr(smplx, CLASSES[name])(str(place), **arguments | options)
    # Its extra joints are vertices by number, which a small mesh does not have; ours are compared elsewhere.
    module.vertex_joint_selector.extra_joints_idxs = torch.zeros(0, dtype=torch.long)
    return module


def _random_parameters(model, rng):
    def draw(*shape, scale):
        return torch.tensor(rng.normal(scale=scale, size=shape), requires_grad=True)

    return {
        "shape": draw(BATCH, model.shape_count, scale=1.0),
        "expression": draw(BATCH, model.expression_count, scale=1.0),
        "pose": draw(BATCH, model.joint_count, 3, scale=0.5),
        "translation": draw(BATCH, 3, scale=0.5),
    }


def _ours(model, parameters):
    return model(
        parameters["shape"], FullPose(parameters["pose"]), parameters["expression"], parameters["translation"]
    )


def _theirs(name, module, parameters):
    arguments, first = {}, 0
    for argument, count in POSE_ARGUMENTS[name].items():
        arguments[argument] = parameters["pose"][:, first : first + count].reshape(BATCH, 3 * count)
        first += count
    if name in ("smplx", "flame"):
        arguments["expression"] = parameters["expression"]
    return module(betas=parameters["shape"], transl=parameters["translation"], **arguments)


def _assert_same(
    name, model, module, rng, vertex_tolerance=VERTEX_TOLERANCE, gradient_tolerance=GRADIENT_TOLERANCE
):
    parameters = _random_parameters(model, rng)
    ours, theirs = _ours(model, parameters), _theirs(name, module, parameters)
    K = model.joint_count
    assert torch.abs(ours.vertices - theirs.vertices).max() < vertex_tolerance
    assert torch.abs(ours.joints - theirs.joints[:, :K]).max() < vertex_tolerance
    direction = torch.tensor(rng.normal(size=ours.vertices.shape))
    joint_direction = torch.tensor(rng.normal(size=ours.joints.shape))
    wanted = [parameter for parameter in parameters.values() if parameter.numel()]
    gradients = [
        torch.autograd.grad((v * direction).sum() + (j * joint_direction).sum(), wanted)
        for v, j in ((ours.vertices, ours.joints), (theirs.vertices, theirs.joints[:, :K]))
    ]
    for mine, reference in zip(*gradients, strict=True):
        assert torch.linalg.norm(mine - reference) < gradient_tolerance * torch.linalg.norm(reference)


def _write_official(official, name, folder, arrays):
    ending = ".npz" if name == "smplx" else ".pkl"
    write = official.write_npz if ending == ".npz" else official.write_plain_pickle
    return write(folder / f"{FILE_NAMES[name]}{ending}", arrays)


@pytest.mark.parametrize("name", FAMILIES)
def test_full_size_files_give_the_vertices_joints_and_gradients_of_smplx(official, name, tmp_path, rng):
    arrays = official.official_arrays(name, rng, official.FULL_SIZES[name])
    path = _write_official(official, name, tmp_path, arrays)
    model = load_model(path)
    module = _smplx_module(name, path, model.shape_count, model.expression_count)
    _assert_same(name, model, module, rng)


@pytest.mark.parametrize("name", FAMILIES)
def test_all_that_is_left_is_the_rotation_formula_of_smplx(official, name, tmp_path, rng, monkeypatch):
    monkeypatch.setattr("smplx.lbs.batch_rodrigues", matrix_from_axis_angle)
    path = _write_official(official, name, tmp_path, official.official_arrays(name, rng))
    model = load_model(path)
    module = _smplx_module(name, path, model.shape_count, model.expression_count)
    _assert_same(name, model, module, rng, vertex_tolerance=1e-13, gradient_tolerance=1e-13)


@pytest.mark.parametrize("name", FAMILIES)
def test_chumpy_pickles_give_the_vertices_of_smplx_on_the_plain_file(official, name, tmp_path, rng):
    arrays = official.official_arrays(name, rng)
    path = _write_official(official, name, tmp_path, arrays)
    model = load_model(official.write_chumpy_pickle(tmp_path / "research.pkl", arrays))
    module = _smplx_module(name, path, model.shape_count, model.expression_count)
    _assert_same(name, model, module, rng)


# smplx reads SMPL from pickles only.
READABLE = [
    (name, ending) for name in FAMILIES for ending in (".npz", ".pkl") if (name, ending) != ("smpl", ".npz")
]


@pytest.mark.parametrize("layout", ["native", "official"])
@pytest.mark.parametrize("columns", ["few", "many"])
@pytest.mark.parametrize(("name", "ending"), READABLE)
def test_files_that_we_write_come_out_right_in_smplx(official, name, columns, ending, layout, tmp_path, rng):
    small = official.SMALL_COLUMNS[name]
    count = small if columns == "few" else {10: 300, 20: 400}[small]
    model = load_model(
        _write_official(official, name, tmp_path, official.official_arrays(name, rng, (60, 90, count)))
    )
    # Counts for which smplx has no rule of its own: 7 and 4, or 37 and 23, directions.
    S, E = (7, 4) if columns == "few" else (37, 23)
    model = model.replace(
        shape_directions=model.shape_directions[:, :, :S],
        expression_directions=model.expression_directions[:, :, :E],
    )
    folder = tmp_path / "ours"
    folder.mkdir()
    path = folder / f"{FILE_NAMES[name]}{ending}"
    save_model(model, path, layout=layout)
    padded_shape, padded_expression = (10, 10) if columns == "few" else (300, 100)
    module = _smplx_module(name, path, padded_shape, padded_expression)
    parameters = _random_parameters(model, rng)
    padded = dict(parameters)
    padded["shape"] = torch.nn.functional.pad(parameters["shape"], (0, padded_shape - S))
    padded["expression"] = torch.nn.functional.pad(
        parameters["expression"], (0, padded_expression - model.expression_count)
    )
    ours, theirs = _ours(model, parameters), _theirs(name, module, padded)
    assert torch.abs(ours.vertices - theirs.vertices).max() < VERTEX_TOLERANCE
    assert torch.abs(ours.joints - theirs.joints[:, : model.joint_count]).max() < VERTEX_TOLERANCE


def test_a_model_without_correctives_comes_out_right_in_smplx(official, tmp_path, rng):
    model = load_model(official.write_npz(tmp_path / "a.npz", official.official_arrays("mano", rng)))
    model = model.replace(pose_directions=np.zeros((model.vertex_count, 3, 0)))
    path = tmp_path / "MANO_RIGHT.npz"
    save_model(model, path)
    _assert_same("mano", model, _smplx_module("mano", path, 10, 0), rng)
    assert not load_model(path).has_correctives


@pytest.mark.parametrize(("mean_included", "flat"), [(True, False), (False, True)])
def test_hand_coefficients_mean_the_same_as_in_smplx(official, mean_included, flat, tmp_path, rng):
    path = official.write_npz(tmp_path / "MANO_RIGHT.npz", official.official_arrays("mano", rng))
    model = load_model(path)
    block = model.block("hand")
    assert block.mean_included
    if not mean_included:
        model = model.replace(pose_blocks=(dataclasses.replace(block, mean_included=False),))
    module = _smplx_module("mano", path, 10, 0, use_pca=True, num_pca_comps=6, flat_hand_mean=flat)
    coefficients = torch.tensor(rng.normal(size=(BATCH, 6)))
    root = torch.tensor(rng.normal(scale=0.5, size=(BATCH, 3)))
    ours = model(None, CoefficientPose(root, {"hand": coefficients}))
    theirs = module(
        betas=torch.zeros(BATCH, 10, dtype=torch.float64),
        global_orient=root,
        hand_pose=coefficients,
        transl=torch.zeros(BATCH, 3, dtype=torch.float64),
    )
    assert torch.abs(ours.vertices - theirs.vertices).max() < VERTEX_TOLERANCE


def test_face_landmarks_are_those_of_smplx(official, tmp_path, rng):
    path = official.write_npz(tmp_path / "SMPLX_NEUTRAL.npz", official.official_arrays("smplx", rng))
    model = load_model(path)
    module = _smplx_module("smplx", path, 10, 10)
    parameters = _random_parameters(model, rng)
    ours, theirs = _ours(model, parameters), _theirs("smplx", module, parameters)
    landmarks = model.landmarks["face"]
    for row in range(BATCH):
        mine = landmarks.positions(ours.vertices[row].detach().numpy(), ours.joints[row].detach().numpy())
        assert (
            np.abs(mine - theirs.joints[row, model.joint_count :].detach().numpy()).max() < VERTEX_TOLERANCE
        )
