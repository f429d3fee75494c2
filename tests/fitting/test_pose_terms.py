"""Priors of tracking: what toes may do."""

import numpy as np
import pytest

from corporeal.fitting.options import TrackingOptions
from corporeal.fitting.pose_terms import pose_terms
from corporeal.model.files import open_model
from corporeal.model.jacobian import ParameterColumns
from corporeal.solve.problem import PARAMETERS


def _toes(model):
    columns = ParameterColumns.of_counts(model.joint_count, 0, 0)
    terms = pose_terms(model, columns, TrackingOptions(), 500.0, previous=None, body_prior=False)
    return columns, [term for term in terms if term.name == "toes"]


@pytest.mark.parametrize("side", ["left", "right"])
def test_toes_turn_up_and_down_but_not_sideways(side):
    body = open_model("body")
    columns, (term,) = _toes(body)
    parameters = np.zeros(columns.count)
    turns = parameters[columns.pose].reshape(-1, 3)
    toes = body.joint_names.index(f"{side}_foot")
    turns[toes, 0] = 0.6
    assert term.at({PARAMETERS: parameters}).cost == 0
    for axis in (1, 2):
        turns[toes] = 0.0
        turns[toes, axis] = np.deg2rad(20.0)
        assert 30 < term.at({PARAMETERS: parameters}).cost < 300


def test_a_hand_has_none():
    assert _toes(open_model("hand"))[1] == []
