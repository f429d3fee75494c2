"""Where fits begin, against registrations that the model can meet exactly."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from corporeal.learning.evaluation.fit_start import start_on
from corporeal.learning.evaluation.protocols import PoseAndShape, PoseOnly
from corporeal.model.jacobian import evaluate


def posed(model, parameters):
    return evaluate(model, parameters.shape, parameters.pose, parameters.translation).vertices


@pytest.mark.parametrize("free", [True, False])
def test_a_start_lies_on_the_registration_from_a_pose_that_is_not_its_own(
    bent_tube, tube_scan, personal, free
):
    true = tube_scan(21).true
    R, t = Rotation.random(random_state=3).as_matrix(), np.array([1.0, 2.0, 3.0])
    vertices = posed(bent_tube, true) @ R.T + t
    # Of another model, whose joints are not these: a quarter of a radian off, and its root is another.
    pose = true.pose + np.array([[2.0, 0, 0], [0, 0.25, 0.25], [0.25, 0, -0.25]])
    model, protocol = (bent_tube, PoseAndShape()) if free else (personal(bent_tube, true), PoseOnly())
    start = start_on(model, pose, vertices, protocol)
    assert start.shape.shape == ((3,) if free else (0,))
    assert np.linalg.norm(posed(model, start) - vertices, axis=1).mean() < 2e-4


def test_it_knows_whether_correctives_are_left_out(bent_tube, tube_scan, personal):
    true = tube_scan(22).true
    model, vertices = personal(bent_tube, true), posed(bent_tube, true)
    start = start_on(model, true.pose, vertices, PoseOnly(), correctives=False)
    rigid = model.replace(pose_directions=np.zeros((model.vertex_count, 3, 0)))
    same = start_on(rigid, true.pose, vertices, PoseOnly())
    assert np.abs(start.pose - same.pose).max() < 1e-5
    assert np.abs(start.pose - true.pose).max() > 1e-3


def test_what_does_not_fit_the_model_is_refused(bent_tube, tube_scan):
    known = tube_scan(23)
    with pytest.raises(ValueError, match="share template and tree"):
        start_on(bent_tube, known.pose, known.vertices[:-1], PoseAndShape())
    with pytest.raises(ValueError, match="personal model"):
        start_on(bent_tube, known.pose, known.vertices, PoseOnly())
