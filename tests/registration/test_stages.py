import gc
import weakref

import numpy as np

from corporeal.model.files import open_model
from corporeal.model.mirror import mirror_model
from corporeal.registration.options import RegistrationOptions
from corporeal.registration.register import model_of_side
from corporeal.registration.stages import Fitter
from corporeal.registration.target import Target
from corporeal.scans.scan import Scan, Unit


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
