"""Rigs from geometry: what every user's first model must hold, and what is refused."""

import numpy as np
import pytest

from corporeal.learning.rigging import bone_weights, ring_regressor, strongest_joints
from corporeal.learning.start_model import crude_start, start_model
from corporeal.model.files import open_model
from corporeal.model.jacobian import evaluate

SIDES = 12


@pytest.fixture(scope="module")
def hand():
    return open_model("hand")


@pytest.fixture(scope="module")
def crude(hand):
    return crude_start(hand)


@pytest.fixture
def arguments(known_tube):
    model = known_tube.model
    return {
        "template": model.template,
        "faces": model.faces,
        "joints": model.joint_regressor @ model.template,
        "parents": model.parents.tolist(),
        "joint_names": model.joint_names,
    }


def test_weights_are_shares_of_at_most_four_joints(crude):
    weights = crude.skinning_weights
    assert (weights >= 0).all()
    assert np.abs(weights.sum(axis=1) - 1).max() < 1e-12
    assert (weights > 0).sum(axis=1).max() <= 4
    assert (weights.max(axis=0) > 0.99).all(), "every joint has vertices of its own"


def test_weights_do_not_jump_along_the_surface(crude):
    steps = np.abs(crude.skinning_weights[crude.faces[:, 0]] - crude.skinning_weights[crude.faces[:, 1]]).max(
        axis=1
    )
    lengths = np.linalg.norm(crude.template[crude.faces[:, 0]] - crude.template[crude.faces[:, 1]], axis=1)
    # From one to zero within a finger's half width takes more than 3 mm.
    assert (steps / lengths).max() < 1 / 3e-3


def test_weights_do_not_jump_from_limb_to_limb():
    """A thin limb beside a thick one: the thin bone is near to the thick one's skin, but far along it."""
    down = np.linspace(0, 0.2, 41)
    turn = np.linspace(0, np.pi, 22)[1:-1]
    path = np.concatenate(
        [
            np.stack([-down, 0 * down, 0 * down], axis=1),
            np.stack([-0.2 - 0.02 * np.sin(turn), 0.02 - 0.02 * np.cos(turn), 0 * turn], axis=1),
            np.stack([-down[::-1], 0 * down + 0.04, 0 * down], axis=1),
        ]
    )
    radii = np.concatenate([np.full(41, 0.030), np.linspace(0.03, 0.005, 20), np.full(41, 0.005)])
    points, faces = tube_along(path, radii)
    joints = np.array([[-0.01, 0, 0], [-0.2, 0, 0], [-0.2, 0.04, 0]])
    thick, thin = np.arange(len(points)) < 35 * SIDES, np.arange(len(points)) >= 65 * SIDES
    nearer = np.linalg.norm(points[:, 1:] - [0.04, 0], axis=1) < np.linalg.norm(points[:, 1:], axis=1)
    assert (thick & nearer).any(), "the test wants skin that is nearer to the other limb's bone"
    weights = bone_weights(points, faces, joints, np.array([-1, 0, 1]), ("thick", "turn", "thin"))
    assert (weights[thick, 2] == 0).all()
    assert (weights[thin, 0] == 0).all()


def tube_along(path: np.ndarray, radii: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """An open tube around a path in the plane z = 0."""
    ahead = np.gradient(path, axis=0)
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    sideways = np.cross(ahead, [0, 0, 1])
    angles = 2 * np.pi * np.arange(SIDES) / SIDES
    rings = np.cos(angles)[:, None] * sideways[:, None] + np.sin(angles)[:, None] * np.array([0, 0, 1])
    points = path[:, None] + radii[:, None, None] * rings
    first = np.arange((len(path) - 1) * SIDES)
    other = first - first % SIDES + (first + 1) % SIDES
    faces = np.concatenate(
        [
            np.stack([first, other, first + SIDES], axis=1),
            np.stack([other, other + SIDES, first + SIDES], axis=1),
        ]
    )
    return points.reshape(-1, 3), faces


def test_rings_give_the_joints(hand, crude):
    regressor, joints = crude.joint_regressor, hand.joint_regressor @ hand.template
    assert np.abs(regressor @ hand.template - joints).max() < 1e-6
    assert regressor.data.min() >= 0
    assert np.abs(np.asarray(regressor.sum(axis=1)).ravel() - 1).max() < 1e-12
    sizes = np.diff(regressor.indptr)
    assert sizes.max() <= 60
    assert regressor.max() <= 0.25 + 1e-12
    for joint in range(hand.joint_count):
        arms = hand.template[regressor[joint].indices] - joints[joint]
        assert np.linalg.norm(arms, axis=1).max() < 0.035


def test_rings_follow_a_scaled_and_moved_template(hand, crude, rng):
    moved = 1.3 * hand.template @ np.linalg.qr(rng.standard_normal((3, 3)))[0] + rng.standard_normal(3)
    again = ring_regressor(
        moved, crude.joint_regressor @ moved, hand.parents, crude.skinning_weights, hand.joint_names
    )
    assert np.abs((again @ moved) - (crude.joint_regressor @ moved)).max() < 1e-6


def test_crude_start_keeps_what_is_no_rig(hand, crude):
    for name in ("faces", "parents", "template"):
        assert np.array_equal(getattr(crude, name), getattr(hand, name))
    for name in ("joint_names", "side", "landmarks", "parts", "pose_blocks", "cut"):
        assert getattr(crude, name) == getattr(hand, name)
    assert not crude.has_correctives
    assert crude.shape_count == 1


def test_shape_space_is_the_size(hand, crude):
    """One standard deviation makes the hand 7 % larger about its wrist, which stays."""
    larger = evaluate(crude, np.ones(1), np.zeros((16, 3)), np.zeros(3))
    joints = hand.joint_regressor @ hand.template
    assert np.abs(larger.vertices - joints[0] - 1.07 * (hand.template - joints[0])).max() < 1e-12
    assert np.abs(larger.joints - joints[0] - 1.07 * (joints - joints[0])).max() < 2e-6


def test_own_weights_are_kept(arguments, known_tube):
    weights = known_tube.model.skinning_weights
    model = start_model(**arguments, name="arm", weights=weights)
    assert np.abs(model.skinning_weights - weights).max() < 1e-12
    assert model.pose_blocks[0].joints == (1, 2)
    assert model.name == "arm"
    assert np.abs(model.joint_regressor @ model.template - arguments["joints"]).max() < 1e-6


def test_a_start_model_without_limbs(arguments):
    """A single joint: a rigid thing."""
    arguments |= {"joints": arguments["joints"][:1], "parents": [-1], "joint_names": ("all",)}
    model = start_model(**arguments, name="stone")
    assert (model.skinning_weights == 1).all()
    assert model.pose_blocks == ()


def test_the_four_strongest_stay(rng):
    weights = rng.dirichlet(np.ones(7), size=20)
    kept = strongest_joints(weights)
    assert ((kept > 0).sum(axis=1) == 4).all()
    assert np.abs(kept.sum(axis=1) - 1).max() < 1e-12
    smallest = np.where(kept > 0, weights, np.inf).min(axis=1)
    assert (np.where(kept > 0, 0, weights).max(axis=1) <= smallest).all()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"joints": lambda a: a["joints"] + [0, 0.05, 0]}, "joints: 'base' is not surrounded"),
        ({"joints": lambda a: a["joints"][:2]}, r"joints: expected \(3, 3\)"),
        ({"joints": lambda a: a["joints"] * np.nan}, "joints: expected"),
        ({"joints": lambda a: a["joints"] * [1, 1, 1] + np.array([[0, 0, 0], [0, 0, 0], [-0.5, 0, 0]])},
         "joints: no vertex is nearest to the bone of 'tip'"),
        ({"parents": lambda a: [-1, 2, 1]}, "parents: expected the root first"),
        ({"parents": lambda a: [0, 0, 1]}, "parents: expected the root first"),
        ({"parents": lambda a: [-1, 0]}, "parents: expected 3 numbers"),
        ({"joint_names": lambda a: ("a", "b", "b")}, "joint_names: expected 3 different"),
        ({"template": lambda a: 1000 * a["template"]}, "template: 128 m across; expected metres"),
        ({"template": lambda a: np.where(a["template"] > 0.3, np.nan, a["template"])}, "template: expected"),
        ({"faces": lambda a: a["faces"] + 5}, "faces: expected vertex indices"),
        ({"faces": lambda a: a["faces"][::2]}, "vertices do not hang together"),
        ({"weights": lambda a: np.ones((len(a["template"]), 3))}, "weights: expected rows .* vertex 0 has 3"),
        ({"weights": lambda a: np.ones((5, 3)) / 3}, r"weights: expected \(252, 3\)"),
        ({"weights": lambda a: np.tile([2.0, -1, 0], (len(a["template"]), 1))}, "weights: expected finite"),
        ({"size_deviation": lambda a: 7.0}, "size_deviation: expected a share"),
    ],
)  # fmt: skip
def test_refusals_name_the_argument(arguments, changes, words):
    changed = {name: change(arguments) for name, change in changes.items()}
    with pytest.raises(ValueError, match=words):
        start_model(**{**arguments, "name": "arm", **changed})
