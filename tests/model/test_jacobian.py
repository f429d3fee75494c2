"""The closed-form Jacobian against automatic differentiation and finite differences, and its values."""

import runpy
from pathlib import Path

import numpy as np
import pytest
import torch

from corporeal.geometry.rotations import matrix_from_axis_angle
from corporeal.model import jacobian
from corporeal.model.jacobian import ParameterColumns, evaluate, linearise
from corporeal.model.reference import reference_surface

SYNTHETIC = runpy.run_path(str(Path(__file__).parents[1] / "synthetic.py"))

POSES = {
    "zero": lambda rng: np.zeros((5, 3)),
    "tiny": lambda rng: 1e-9 * rng.standard_normal((5, 3)),
    "series_edge": lambda rng: np.sqrt(1e-3 / 3) * np.ones((5, 3)) * (1 + 1e-6 * rng.standard_normal((5, 1))),
    "random": lambda rng: rng.standard_normal((5, 3)),
    "pi": lambda rng: _of_angle(rng, np.pi),
    "two_pi": lambda rng: _of_angle(rng, 2 * np.pi),
}


def _of_angle(rng, angle):
    axis = rng.standard_normal((5, 3))
    return angle * axis / np.linalg.norm(axis, axis=1, keepdims=True)


@pytest.fixture(params=["sparse_weights", "dense_weights"])
def model(request, rng):
    return SYNTHETIC["random_model"](rng, dense_weights=request.param == "dense_weights")


@pytest.fixture(params=list(POSES))
def parameters(request, rng):
    """Shape, pose, translation, expression."""
    pose = POSES[request.param](rng)
    return rng.standard_normal(4), pose, rng.standard_normal(3), rng.standard_normal(2)


def _reference(model, shape, pose, translation, expression, correctives):
    coefficients = torch.cat([shape, expression])[None]
    matrices = matrix_from_axis_angle(pose)[None]
    tensors = model.tensors(torch.float64)
    surface = reference_surface(tensors, coefficients, matrices, translation[None], correctives)
    return surface.vertices[0], surface.joints[0], surface.T_world_joint[0]


@pytest.mark.parametrize("correctives", [True, False])
def test_values_are_those_of_the_reference(model, parameters, correctives):
    expected = _reference(model, *map(torch.from_numpy, parameters), correctives)
    for posed in (evaluate, linearise):
        got = posed(model, *parameters, correctives=correctives)
        for ours, theirs in zip((got.vertices, got.joints, got.T_world_joint), expected, strict=True):
            np.testing.assert_allclose(ours, theirs.numpy(), rtol=0, atol=1e-12)


@pytest.mark.filterwarnings("ignore:.torch.jit.script. is deprecated:DeprecationWarning")  # torch's own call
@pytest.mark.parametrize("correctives", [True, False])
def test_equals_automatic_differentiation(model, parameters, correctives):
    def reference(shape, pose, translation, expression):
        return _reference(model, shape, pose, translation, expression, correctives)[:2]

    tensors = tuple(map(torch.from_numpy, parameters))
    by_argument = torch.func.jacfwd(reference, argnums=(2, 1, 0, 3))(*tensors)
    got = linearise(model, *parameters, correctives=correctives)
    for ours, theirs in zip((got.vertex_jacobian, got.joint_jacobian), by_argument, strict=True):
        expected = torch.cat([block.flatten(2) for block in theirs], dim=2).numpy()
        np.testing.assert_allclose(ours, expected, rtol=0, atol=1e-12)


def test_equals_finite_differences_along_random_directions(model, parameters, rng):
    shape, pose, translation, expression = parameters
    here = linearise(model, shape, pose, translation, expression)
    step = 1e-5
    for _ in range(5):
        direction = rng.standard_normal(here.columns.count)

        def moved(sign, direction=direction):
            part = {name: sign * step * direction[getattr(here.columns, name)] for name in
                    ("translation", "pose", "shape", "expression")}  # fmt: skip
            return evaluate(
                model, shape + part["shape"], pose + part["pose"].reshape(-1, 3),
                translation + part["translation"], expression + part["expression"],
            )  # fmt: skip

        after, before = moved(1), moved(-1)
        numeric = (after.vertices - before.vertices) / (2 * step)
        np.testing.assert_allclose(here.vertex_jacobian @ direction, numeric, rtol=1e-6, atol=1e-7)
        numeric = (after.joints - before.joints) / (2 * step)
        np.testing.assert_allclose(here.joint_jacobian @ direction, numeric, rtol=1e-6, atol=1e-7)


def test_fewer_coefficients_are_the_first_columns(model, parameters):
    shape, pose, translation, expression = parameters
    padded = linearise(model, np.append(shape[:2], [0, 0]), pose, translation, np.append(expression[:1], 0))
    short = linearise(model, shape[:2], pose, translation, expression[:1])
    np.testing.assert_allclose(short.vertices, padded.vertices, atol=1e-15)
    kept = np.r_[0 : 3 + 15 + 2, 3 + 15 + 4]
    np.testing.assert_allclose(short.vertex_jacobian, padded.vertex_jacobian[:, :, kept], atol=1e-15)
    assert short.columns == ParameterColumns(slice(0, 3), slice(3, 18), slice(18, 20), slice(20, 21))


def test_one_thread_and_several_give_the_same(model, parameters, monkeypatch):
    results = []
    for least_work in (0, 10**12):
        monkeypatch.setattr(jacobian, "_PARALLEL_FROM", least_work)
        results.append(linearise(model, *parameters))
    np.testing.assert_array_equal(results[0].vertices, results[1].vertices)
    np.testing.assert_array_equal(results[0].vertex_jacobian, results[1].vertex_jacobian)


def test_the_jacobian_reshapes_without_a_copy(model, parameters):
    here = linearise(model, *parameters)
    flat = here.vertex_jacobian.reshape(-1, here.columns.count)
    assert np.shares_memory(flat, here.vertex_jacobian)


def test_what_a_joint_does_not_carry_has_zero_columns(rng):
    model = SYNTHETIC["random_model"](rng)
    here = linearise(model, np.zeros(0), rng.standard_normal((5, 3)), np.zeros(3), correctives=False)
    carried = model.skinning_weights.copy()
    for joint in range(4, 0, -1):
        carried[:, model.parents[joint]] += carried[:, joint]
    untouched = here.vertex_jacobian[:, :, here.columns.pose].reshape(-1, 3, 5, 3)
    assert (carried == 0).any()
    np.testing.assert_array_equal(np.abs(untouched).max(axis=(1, 3))[carried == 0], 0)


def test_wrong_lengths_are_named(rng):
    model = SYNTHETIC["random_model"](rng)
    with pytest.raises(ValueError, match=r"pose: shape \(4, 3\), expected \(5, 3\)"):
        evaluate(model, np.zeros(0), np.zeros((4, 3)), np.zeros(3))
    with pytest.raises(ValueError, match="shape: 9 coefficients for 4"):
        linearise(model, np.zeros(9), np.zeros((5, 3)), np.zeros(3))
    with pytest.raises(ValueError, match="expression: 3 coefficients for 2"):
        linearise(model, np.zeros(0), np.zeros((5, 3)), np.zeros(3), np.zeros(3))
