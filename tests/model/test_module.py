"""The module gives what the model gives, follows ``.to()`` and keeps its arrays in ``state_dict``."""

import runpy
from pathlib import Path

import pytest
import torch

from corporeal.model.module import SurfaceModule
from corporeal.model.pose import CoefficientPose, FullPose

SYNTHETIC = runpy.run_path(str(Path(__file__).parents[1] / "synthetic.py"))


@pytest.fixture
def model(rng):
    return SYNTHETIC["random_model"](rng)


def _parameters(rng, batch, dtype):
    def draw(*size):
        return torch.tensor(rng.standard_normal(size), dtype=dtype, requires_grad=True)

    return draw(batch, 4), FullPose(draw(batch, 5, 3)), draw(batch, 2), draw(batch, 3)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("correctives", [True, False])
def test_gives_what_the_model_gives(model, rng, dtype, correctives):
    parameters = _parameters(rng, 3, dtype)
    module = SurfaceModule(model, dtype)
    ours, theirs = module(*parameters, correctives=correctives), model(*parameters, correctives=correctives)
    for name in ("vertices", "joints", "T_world_joint"):
        torch.testing.assert_close(getattr(ours, name), getattr(theirs, name), rtol=0, atol=0)
    coefficients = CoefficientPose(parameters[3], {"right_hand": torch.ones(3, 2, dtype=dtype)})
    torch.testing.assert_close(
        module(None, coefficients).vertices, model(None, coefficients).vertices, rtol=0, atol=0
    )


def test_to_changes_the_dtype_and_the_result_follows(model, rng):
    module = SurfaceModule(model)
    single = module(*_parameters(rng, 2, torch.float32))
    assert single.vertices.dtype == torch.float32
    module.to(torch.float64)
    parameters = _parameters(rng, 2, torch.float64)
    double = module(*parameters)
    assert double.vertices.dtype == torch.float64
    torch.testing.assert_close(double.vertices, model(*parameters).vertices, rtol=0, atol=1e-6)
    with pytest.raises(ValueError, match=r"pose: torch.float32 on cpu, but the module is torch.float64"):
        module(*_parameters(rng, 2, torch.float32))


def test_state_dict_holds_the_arrays_and_loading_takes_effect(model, rng):
    other = SYNTHETIC["random_model"](rng)
    parameters = _parameters(rng, 2, torch.float64)
    module = SurfaceModule(model, torch.float64)
    module(*parameters)
    assert set(module.state_dict()) == {"basis", "joint_template", "joint_directions", "skinning_weights"}
    module.load_state_dict(SurfaceModule(other, torch.float64).state_dict())
    torch.testing.assert_close(module(*parameters).vertices, other(*parameters).vertices, rtol=0, atol=0)


def test_loading_leaves_the_model_and_its_cache_alone(model, rng):
    parameters = _parameters(rng, 2, torch.float32)
    before = model(*parameters).vertices.clone()
    module = SurfaceModule(model)
    with torch.no_grad():
        module.basis.zero_()
    torch.testing.assert_close(model(*parameters).vertices, before, rtol=0, atol=0)


def test_gradients_flow_to_the_parameters(model, rng):
    shape, pose, expression, translation = _parameters(rng, 2, torch.float32)
    SurfaceModule(model)(shape, pose, expression, translation).vertices.square().sum().backward()
    for tensor in (shape, pose.values, expression, translation):
        assert tensor.grad is not None
        assert tensor.grad.abs().max() > 0


def test_buffers_that_want_gradients_get_them(model, rng):
    module = SurfaceModule(model, torch.float64)
    module.basis.requires_grad_()
    module(*_parameters(rng, 2, torch.float64)).vertices.sum().backward()
    assert module.basis.grad.abs().max() > 0
