"""The CPU kernels against plain torch: values, gradients, finite differences, second derivatives."""

import runpy
from pathlib import Path

import numpy as np
import pytest
import torch

from corporeal.model.fast_path import fast_surface
from corporeal.model.pose import FullPose
from corporeal.model.reference import reference_surface

SYNTHETIC = runpy.run_path(str(Path(__file__).parents[1] / "synthetic.py"))
OUTPUTS = ("vertices", "joints", "T_world_joint")
TOLERANCE = {torch.float64: 1e-13, torch.float32: 5e-6}
ANGLES = {"zero": 0.0, "tiny": 1e-9, "series_edge": np.sqrt(1e-3), "pi": np.pi, "two_pi": 2 * np.pi}


@pytest.fixture(params=["three_weights", "four_weights", "all_weights"])
def model(request, rng):
    """Four weights per vertex, as most files have, have a loop of their own."""
    model = SYNTHETIC["random_model"](rng, dense_weights=request.param != "three_weights")
    if request.param != "four_weights":
        return model
    weights = model.skinning_weights + 0.1
    weights[np.arange(len(weights)), rng.integers(weights.shape[1], size=len(weights))] = 0
    return model.replace(skinning_weights=weights / weights.sum(axis=1, keepdims=True))


def _draw(rng, dtype, *size):
    return torch.tensor(rng.standard_normal(size), dtype=dtype, requires_grad=True)


def _parameters(rng, batch, dtype, angle=None):
    """Coefficients, axis-angle, translation; all of one angle if it is given."""
    axis_angle = rng.standard_normal((batch, 5, 3))
    if angle is not None:
        axis_angle *= angle / np.linalg.norm(axis_angle, axis=-1, keepdims=True)
    turn = torch.tensor(axis_angle, dtype=dtype, requires_grad=True)
    return _draw(rng, dtype, batch, 6), turn, _draw(rng, dtype, batch, 3)


def _fast(tensors, coefficients, turn, translation, correctives, representation="axis_angle"):
    pose = FullPose(turn)
    if representation == "matrix":
        pose = FullPose(pose.matrices(), "matrix")
    return fast_surface(tensors, coefficients, pose, translation, correctives)


def _reference(tensors, coefficients, turn, translation, correctives):
    return reference_surface(tensors, coefficients, FullPose(turn).matrices(), translation, correctives)


def _outputs(surface):
    return [getattr(surface, name) for name in OUTPUTS]


def _compare(model, rng, parameters, correctives, representation, used=OUTPUTS):
    dtype = parameters[0].dtype
    tensors = model.tensors(dtype)
    ours = _fast(tensors, *parameters, correctives, representation)
    theirs = _reference(tensors, *parameters, correctives)
    for got, expected in zip(_outputs(ours), _outputs(theirs), strict=True):
        torch.testing.assert_close(got, expected, rtol=TOLERANCE[dtype], atol=TOLERANCE[dtype])
    pulls = {name: torch.tensor(rng.standard_normal(getattr(ours, name).shape), dtype=dtype) for name in used}
    gradients = [
        torch.autograd.grad(sum((getattr(s, n) * p).sum() for n, p in pulls.items()), parameters)
        for s in (ours, theirs)
    ]
    for got, expected in zip(*gradients, strict=True):
        scale = expected.abs().max()
        torch.testing.assert_close(got / scale, expected / scale, rtol=0, atol=TOLERANCE[dtype])


@pytest.mark.parametrize("representation", ["axis_angle", "matrix"])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("batch", [1, 3, 9, 16, 37])
def test_equals_plain_torch(model, rng, batch, dtype, representation):
    for correctives in (True, False):
        _compare(model, rng, _parameters(rng, batch, dtype), correctives, representation)


@pytest.mark.parametrize("used", [("vertices",), ("joints",), ("T_world_joint",)])
@pytest.mark.parametrize("batch", [2, 20])
def test_gradients_of_one_output_alone(model, rng, batch, used):
    _compare(model, rng, _parameters(rng, batch, torch.float64), True, "axis_angle", used)


@pytest.mark.parametrize("angle", ANGLES.values(), ids=ANGLES.keys())
@pytest.mark.parametrize("batch", [1, 9])
def test_gradcheck_at_special_angles(model, rng, batch, angle):
    parameters = _parameters(rng, batch, torch.float64, angle)
    tensors = model.tensors(torch.float64)
    assert torch.autograd.gradcheck(
        lambda *given: tuple(_outputs(_fast(tensors, *given, True))), parameters, fast_mode=True
    )


def test_gradients_along_random_directions(model, rng):
    parameters = _parameters(rng, 10, torch.float64)
    tensors, step = model.tensors(torch.float64), 1e-6
    pull = torch.tensor(rng.standard_normal((10, model.vertex_count, 3)))

    def value(*given):
        return (_fast(tensors, *given, True).vertices * pull).sum()

    gradients = torch.autograd.grad(value(*parameters), parameters)
    for _ in range(5):
        directions = [torch.tensor(rng.standard_normal(p.shape)) for p in parameters]
        slope = sum((g * d).sum() for g, d in zip(gradients, directions, strict=True))
        ends = [
            value(*(p + s * d for p, d in zip(parameters, directions, strict=True))) for s in (step, -step)
        ]
        torch.testing.assert_close(slope, (ends[0] - ends[1]) / (2 * step), rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("angle", [0.0, 1.0, np.pi])
def test_second_derivatives(model, rng, angle):
    parameters = _parameters(rng, 2, torch.float64, angle)
    tensors = model.tensors(torch.float64)
    assert torch.autograd.gradgradcheck(
        lambda *given: _fast(tensors, *given, True).vertices, parameters, fast_mode=True
    )


def test_a_large_mesh_on_several_threads(rng, monkeypatch):
    """The thresholds only choose who computes, not what."""
    model = SYNTHETIC["random_model"](rng)
    for name in ("_PARALLEL_BASIS", "_PARALLEL_JOINTS"):
        monkeypatch.setattr(f"corporeal.model.fast_path.{name}", 0)
    for batch in (2, 20):
        _compare(model, rng, _parameters(rng, batch, torch.float64), True, "axis_angle")


def test_a_large_batch_in_several_bands(model, rng, monkeypatch):
    monkeypatch.setattr("corporeal.model.fast_path._BAND_BYTES", 1)
    _compare(model, rng, _parameters(rng, 37, torch.float64), True, "axis_angle")


def test_a_vertex_without_weights_stays_at_the_translation(rng):
    model = SYNTHETIC["random_model"](rng)
    weights = model.skinning_weights.copy()
    weights[7] = 0
    for batch in (2, 20):
        _compare(
            model.replace(skinning_weights=weights),
            rng,
            _parameters(rng, batch, torch.float64),
            True,
            "matrix",
        )


def test_a_frozen_input_gets_no_gradient(model, rng):
    coefficients, turn, translation = _parameters(rng, 2, torch.float64)
    surface = _fast(model.tensors(torch.float64), coefficients.detach(), turn, translation, True)
    surface.vertices.sum().backward()
    assert coefficients.grad is None
    assert turn.grad is not None


def test_a_parameter_changed_in_place_is_noticed(model, rng):
    coefficients, turn, translation = _parameters(rng, 2, torch.float64)
    surface = _fast(model.tensors(torch.float64), coefficients, turn, translation, True)
    with torch.no_grad():
        turn.add_(1)
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        surface.vertices.sum().backward()


def test_strided_inputs(model, rng):
    tensors = model.tensors(torch.float64)
    coefficients, turn, translation = (p.detach() for p in _parameters(rng, 9, torch.float64))
    for every in (1, 3):  # batches of 6 and of 2, for both kinds of kernels
        strided = [torch.stack([p, p], dim=-1)[..., 0][::every] for p in (coefficients, turn, translation)]
        got = _fast(tensors, *strided, True).vertices
        expected = _reference(tensors, *strided, True).vertices
        torch.testing.assert_close(got, expected, rtol=0, atol=1e-13)
