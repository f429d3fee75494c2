"""Groups of vertices that few joints move, and the Jacobian by them."""

import runpy
from pathlib import Path

import numpy as np
import pytest

from corporeal.model import vertex_groups as module
from corporeal.model.files import open_model
from corporeal.model.jacobian import linearise, linearise_groups

SYNTHETIC = runpy.run_path(str(Path(__file__).parents[1] / "synthetic.py"))


@pytest.fixture(params=["body", "hand", "random"])
def model(request, rng):
    return SYNTHETIC["random_model"](rng) if request.param == "random" else open_model(request.param)


def test_every_vertex_is_one_groups_own_and_its_faces_are_around_it(model):
    groups = model.vertex_groups
    assert np.array_equal(
        np.sort(np.concatenate([group.own for group in groups])), np.arange(model.vertex_count)
    )
    for group in groups:
        assert np.array_equal(group.around[: len(group.own)], group.own)
        touched = model.faces[np.isin(model.faces, group.own).any(axis=1)]
        assert set(touched.ravel()) <= set(group.around)
        assert len(set(group.around)) == len(group.around)


def test_the_jacobian_by_groups_is_the_whole_one_without_zeros(model, rng):
    shape, pose = rng.normal(size=3), 0.5 * rng.normal(size=(model.joint_count, 3))
    expression = rng.normal(size=min(2, model.expression_count))
    whole = linearise(model, shape, pose, np.zeros(3), expression)
    grouped = linearise_groups(model, shape, pose, expression)
    assert np.array_equal(grouped.joint_jacobian, whole.joint_jacobian)
    parts = zip(model.vertex_groups, grouped.group_columns, grouped.group_jacobians, strict=True)
    for group, columns, jacobian in parts:
        rows = whole.vertex_jacobian[group.around]
        assert np.array_equal(rows[:, :, columns], jacobian)
        assert not np.delete(rows, columns, axis=2).any()


def test_a_body_is_mostly_zeros(rng):
    body = open_model("body")
    products = sum(len(group.around) * (3 * len(group.joints)) ** 2 for group in body.vertex_groups)
    assert products < 0.15 * body.vertex_count * (3 * body.joint_count) ** 2


def test_too_many_kinds_of_vertices_are_one_group(monkeypatch, rng):
    monkeypatch.setattr(module, "_MOST_SETS", 1)
    model = SYNTHETIC["random_model"](rng)
    (group,) = model.vertex_groups
    assert np.array_equal(group.own, np.arange(model.vertex_count))
    assert np.array_equal(group.around, group.own)
