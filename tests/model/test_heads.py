"""The head that is cut out of the open body."""

import numpy as np
import pytest

from corporeal.geometry.topology import boundary_loops
from corporeal.model.files import open_model
from corporeal.model.heads import HEAD_PARTS, head_of, with_face_marks
from corporeal.model.jacobian import evaluate
from corporeal.registration.subjects import HEAD, subject_of


@pytest.fixture(scope="module")
def body():
    return open_model("body")


@pytest.fixture(scope="module")
def head():
    return open_model("head")


def test_it_ends_in_one_loop_which_its_plane_cuts_off(head):
    loops = boundary_loops(head.faces)
    assert len(loops) == 1
    root = np.asarray(head.joint_regressor @ head.template)[0]
    heights = (head.template - root - head.cut.point) @ head.cut.normal
    assert (heights[loops[0]] < 0.02).all() and (heights > 0).mean() > 0.95
    assert head.cut.normal[1] > 0.8 and head.cut.normal[2] > 0.3  # throats are lower than napes


def test_it_moves_as_the_bodys_head_does(body, head, rng):
    kept = np.unique(np.concatenate([body.parts[part] for part in HEAD_PARTS]))
    joints = [body.joint_names.index(name) for name in head.joint_names]
    shape, expression = rng.normal(size=body.shape_count), rng.normal(size=body.expression_count)
    pose = np.zeros((body.joint_count, 3))
    pose[joints[1:]] = 0.2 * rng.normal(size=(len(joints) - 1, 3))
    whole = evaluate(body, shape, pose, np.zeros(3), expression)
    part = evaluate(head, np.concatenate([shape, expression]), pose[joints], np.zeros(3))
    np.testing.assert_allclose(part.joints, whole.joints[joints], atol=1e-5)
    np.testing.assert_allclose(part.vertices, whole.vertices[kept], atol=2e-5)


def test_its_marks_are_those_of_faces_and_near_the_named_ones(body, head):
    assert set(head.landmarks) == {"face_51_detector", "face_68_ibug", "face"}
    assert subject_of(head) is HEAD and HEAD.detector_set(head) == "face_51_detector"
    posed = evaluate(head, np.zeros(1), np.zeros((5, 3)), np.zeros(3))
    named, seen = (head.landmarks[name] for name in ("face", "face_51_detector"))
    assert named.names == seen.names
    apart = np.linalg.norm(
        named.positions(posed.vertices, posed.joints) - seen.positions(posed.vertices, posed.joints), axis=1
    )
    assert np.median(apart) < 0.006 and apart.max() < 0.015
    mirrored = seen.weights[:, : head.vertex_count] @ (head.template * [-1, 1, 1])
    swapped = [
        seen.names.index(n.replace("left", "X").replace("right", "left").replace("X", "right"))
        for n in seen.names
    ]
    own = seen.weights[swapped][:, : head.vertex_count] @ head.template
    np.testing.assert_allclose(mirrored, own, atol=1e-3)


def test_marks_of_another_body_are_refused(body, head, tmp_path):
    file = tmp_path / "marks.npz"
    np.savez(file, names=np.array(["chin"]), starts=[0, 1], vertices=[0], weights=[1.0], vertex_count=7)
    with pytest.raises(ValueError, match="calibrate it anew"):
        with_face_marks(body, file)
    with pytest.raises(KeyError):
        head_of(open_model("hand"))
