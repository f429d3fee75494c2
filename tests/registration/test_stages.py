import gc
import weakref

import numpy as np
import pytest
import scipy.sparse as sp

from corporeal.geometry.normals import vertex_normals
from corporeal.model.files import open_model
from corporeal.model.landmarks import LandmarkSet
from corporeal.model.mirror import mirror_model
from corporeal.registration.hands_on_arms import on_hands
from corporeal.registration.options import RegistrationOptions
from corporeal.registration.register import model_of_side
from corporeal.registration.stages import Fitter, MeasuredLandmarks
from corporeal.registration.target import Target
from corporeal.scans.scan import Scan, Unit
from corporeal.solve.problem import PARAMETERS
from corporeal.terms.distance import DistanceOptions
from corporeal.terms.model_fields import MODEL, ModelParameters


def fitter_of(model) -> Fitter:
    scan = Scan("x", model.template, model.faces, np.zeros_like(model.template), None, Unit("m", 1.0))
    return Fitter(model, Target(scan), None, RegistrationOptions())


def test_what_depends_on_the_model_is_made_once_and_goes_with_it():
    model = mirror_model(open_model("hand"))
    one, other = fitter_of(model), fitter_of(model)
    assert one.surface is other.surface and one.parts is other.parts
    assert fitter_of(open_model("hand")).surface is not one.surface
    assert model_of_side(model, "right") is model_of_side(model, "right")
    gone = weakref.ref(model)
    del one, other, model
    gc.collect()
    assert gone() is None


@pytest.fixture(scope="module")
def body_fitter():
    """A body whose own skin is the scan."""
    model = open_model("body")
    scan = Scan("x", model.template, model.faces, np.zeros_like(model.template), None, Unit("m", 1.0))
    return Fitter(model, Target(scan), None, RegistrationOptions.for_bodies())


def test_of_hands_only_what_is_outside_is_drawn_back(body_fitter):
    model, stage = body_fitter.model, body_fitter.options.surface[2]
    rest, hands = body_fitter._way_back(stage, DistanceOptions(stage.sigma, stage.robust_scale))
    fingers = on_hands(model)
    assert np.array_equal(hands.weights > 0, fingers) and np.array_equal(rest.weights > 0, ~fingers)
    normals = vertex_normals(model.template, model.faces)
    for out in (1.0, -1.0):
        moved = model.template + out * 3e-3 * normals
        drawn = np.abs(hands.at({MODEL: moved}).quadratic().gradient[MODEL]).sum(axis=1)
        share = (drawn[fingers] > 0).mean()
        assert share > 0.95 if out > 0 else share < 0.05


def test_a_hand_alone_is_drawn_back_as_a_whole():
    fitter = fitter_of(open_model("hand"))
    stage = fitter.options.surface[0]
    (term,) = fitter._way_back(stage, DistanceOptions(stage.sigma, stage.robust_scale))
    assert not term.outside and (term.weights > 0).all()


def test_fingers_that_were_found_are_held_and_stay_held(body_fitter, rng):
    model = body_fitter.model
    marks = MeasuredLandmarks(
        LandmarkSet(("vertex 0",), _one_vertex(model, 0), model.vertex_count), np.zeros((1, 3)), np.ones(1)
    )
    poses = {
        name: 0.1 * rng.normal(size=(len(model.block(name).joints), 3))
        for name in ("left_hand", "right_hand")
    }
    led = body_fitter.led_to(marks, (), {"left_hand": poses["left_hand"]})
    led = led.led_to(marks, ("vertex",), {"right_hand": poses["right_hand"]})
    terms = {term.name: term for term in led._priors(1.0, 1.0)}
    pose = np.zeros((model.joint_count, 3))
    for name, held in poses.items():
        pose[list(model.block(name).joints)] = held
    found = ModelParameters(np.zeros(3), pose, np.zeros(led.fields.shape_count)).vector()
    for name in poses:
        assert terms[f"{name} held"].at({PARAMETERS: found}).cost == 0
        assert terms[f"{name} held"].at({PARAMETERS: np.zeros_like(found)}).cost > 10
    assert not any(term.name.endswith("held") for term in body_fitter._priors(1.0, 1.0))


def _one_vertex(model, vertex):
    shape = (1, model.vertex_count + model.joint_count)
    return sp.csr_matrix(([1.0], ([0], [vertex])), shape=shape)
