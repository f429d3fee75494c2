"""Fields of a model and their Jacobians, against finite differences along random directions."""

import numpy as np
import pytest

from corporeal.model.files import open_model
from corporeal.solve.grouped_slopes import GroupedSlopes
from corporeal.terms.model_fields import LANDMARKS, MODEL, ModelFields

EVERY_KIND = pytest.mark.parametrize(
    ("name", "marks", "correctives"),
    [
        ("hand", "hand_21_mediapipe", True),
        ("hand", "hand_21_mediapipe", False),
        ("soft_hand", "hand_21_detector", True),
        ("body", "mediapipe_33", True),
    ],
)


@EVERY_KIND
def test_jacobians_agree_with_differences(rng, name, marks, correctives):
    model = open_model(name)
    fields = ModelFields(model, shape_count=7, landmarks=model.landmarks[marks], correctives=correctives)
    vector = 0.3 * rng.normal(size=fields.columns.count)
    jacobians = {
        field: slopes.dense().reshape(slopes.shape) if isinstance(slopes, GroupedSlopes) else slopes
        for field, slopes in fields.differentiate(vector).items()
    }
    step = 1e-6
    for _ in range(4):
        direction = rng.normal(size=vector.size)
        up, down = fields.derive(vector + step * direction), fields.derive(vector - step * direction)
        for field in (MODEL, LANDMARKS):
            numeric = (up[field] - down[field]) / (2 * step)
            analytic = jacobians[field] @ direction
            assert np.abs(numeric - analytic).max() < 1e-6 * max(1.0, np.abs(analytic).max())


@EVERY_KIND
def test_landmarks_alone_are_those_of_the_whole_surface(rng, name, marks, correctives):
    """Posed from their own vertices, some moved by correctives and some by joints alone."""
    model = open_model(name)
    whole = ModelFields(model, shape_count=6, landmarks=model.landmarks[marks], correctives=correctives)
    vector = 0.4 * rng.normal(size=whole.columns.count)
    found, slopes = whole.landmarks_alone.derive(vector), whole.landmarks_alone.differentiate(vector)
    assert set(found) == set(slopes) == {LANDMARKS}
    np.testing.assert_allclose(found[LANDMARKS], whole.derive(vector)[LANDMARKS], atol=1e-13)
    np.testing.assert_allclose(slopes[LANDMARKS], whole.differentiate(vector)[LANDMARKS], atol=1e-12)


def test_landmarks_alone_need_landmarks():
    with pytest.raises(ValueError, match="there are none"):
        _ = ModelFields(open_model("hand"), shape_count=0).landmarks_alone


def test_the_vector_and_its_names_agree(rng):
    fields = ModelFields(open_model("hand"), shape_count=4)
    vector = rng.normal(size=3 + 48 + 4)
    assert np.array_equal(fields.parameters(vector).vector(), vector)
    assert LANDMARKS not in fields.derive(vector)
