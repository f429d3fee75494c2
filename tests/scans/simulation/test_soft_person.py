"""The open body as a soft body: what the learned correctives were learned from."""

from pathlib import Path

import numpy as np
import pytest

from corporeal.geometry.topology import signed_volume
from corporeal.model.files import open_model
from corporeal.model.jacobian import evaluate
from corporeal.scans.simulation.tetrahedra import edge_matrices

ASSETS = Path(__file__).parents[3] / "assets"


@pytest.fixture(scope="module")
def body():
    return open_model("body")


@pytest.fixture
def soft_person(monkeypatch):
    monkeypatch.syspath_prepend(ASSETS)
    from open_body import soft_person

    return soft_person


def test_tetrahedra_fill_the_template(body):
    with np.load(ASSETS / "open_body/tetrahedra.npz") as arrays:
        vertices, tets = arrays["tet_vertices"].astype(float), arrays["tets"].astype(int)
    volumes = np.linalg.det(edge_matrices(vertices, tets)) / 6
    assert (volumes > 0).all()
    assert abs(volumes.sum() / signed_volume(body.template, body.faces) - 1) < 0.02
    assert 30_000 < len(tets) < 80_000


def test_bones_move_as_the_model_has_them(body, soft_person, rng):
    pose = 0.4 * rng.normal(size=(55, 3))
    joints = np.asarray(body.joint_regressor @ body.template)
    motions = soft_person.bone_motions(joints, np.asarray(body.parents), pose)
    placed = np.einsum("kab,kb->ka", motions[:, :3, :3], joints) + motions[:, :3, 3]
    np.testing.assert_allclose(placed, evaluate(body, np.zeros(0), pose, np.zeros(3)).joints, atol=1e-12)


@pytest.mark.slow
def test_a_bent_elbow_settles(body, soft_person):
    person = soft_person.SoftPerson(body, body.template)
    pose = np.zeros((55, 3))
    pose[19, 1] = np.deg2rad(80)
    settled = person.posed(pose)
    assert np.array_equal(settled.pose, pose), "no relaxing"
    skinned = evaluate(body, np.zeros(0), pose, np.zeros(3), correctives=False).vertices
    apart = np.linalg.norm(settled.surface - skinned, axis=1)
    hand = body.skinning_weights[:, [21, *range(40, 55)]].sum(1) > 0.999
    assert hand.sum() > 2000 and apart[hand].max() < 1e-6, "rigid hand"
    other_side = body.template[:, 0] > 0.1
    assert apart[other_side].max() < 1e-3
    near = np.linalg.norm(body.template - person.joints[19], axis=1) < 0.08
    assert 2e-3 < apart[near].mean() < 20e-3
    assert (
        abs(signed_volume(settled.surface, body.faces) / signed_volume(body.template, body.faces) - 1) < 2e-3
    )
