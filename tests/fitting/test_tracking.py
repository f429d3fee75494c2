"""A hand followed through a synthetic sequence with lost data, bad frames and a break."""

import dataclasses

import numpy as np
import pytest

from corporeal.fitting.frame_data import FramePoints
from corporeal.fitting.free_vertices import coupled_vertices
from corporeal.fitting.learn_template import TemplateError, learn_subject_template
from corporeal.fitting.options import TrackingOptions
from corporeal.fitting.pose_terms import tracking_subspace
from corporeal.fitting.subject_template import SubjectTemplate, personal_model
from corporeal.fitting.track import Tracker
from corporeal.fitting.unposing import unposed
from corporeal.geometry.normals import vertex_normals
from corporeal.model.files import open_model
from corporeal.model.jacobian import evaluate
from corporeal.scans.scan import Scan, Unit
from corporeal.terms.model_fields import ModelFields, ModelParameters
from corporeal.terms.scan_to_surface import MovingSurface

FRAMES = 12
OPTIONS = TrackingOptions(samples=3000, body_points=1500)


def _scan(name, vertices, faces):
    used = np.unique(faces)
    renumbered = np.full(len(vertices), -1)
    renumbered[used] = np.arange(len(used))
    points, own = vertices[used], renumbered[faces].astype(np.int64)
    return Scan(name, points, own, vertex_normals(points, own), None, Unit("m", 1.0))


@pytest.fixture(scope="module")
def sequence():
    """The hand of one person that opens and moves sideways: model, template, poses, places, vertices."""
    model = open_model("hand")
    shape = np.array([0.8, -0.6, 0.4])
    personal = personal_model(model, model.template + model.shape_directions[:, :, :3] @ shape)
    block = next(b for b in model.pose_blocks if len(b.components))
    poses, places, surfaces = [], [], []
    for frame in range(FRAMES):
        coefficients = np.zeros(len(block.components))
        coefficients[:2] = 0.04 * frame, -0.03 * frame
        pose = np.zeros((model.joint_count, 3))
        pose[list(block.joints)] = (block.mean + coefficients @ block.components).reshape(-1, 3)
        pose[0] = 0.02 * frame, 0.01 * frame, 0.0
        poses.append(pose)
        places.append(np.array([0.004 * frame, 0.0, 0.002 * frame]))
        surfaces.append(evaluate(personal, np.zeros(0), pose, places[-1]).vertices)
    template = SubjectTemplate(personal, shape, (), {}, poses[0], places[0])
    return model, template, poses, places, surfaces


def _wall():
    """A square of two metres."""
    u, v = np.meshgrid(np.arange(30), np.arange(30), indexing="ij")
    corner = (u[:-1, :-1] * 30 + v[:-1, :-1]).ravel()
    faces = [
        np.stack([corner, corner + 30, corner + 1], 1),
        np.stack([corner + 1, corner + 30, corner + 31], 1),
    ]
    return np.stack([u / 15, v / 15, 0 * u], -1).reshape(-1, 3).astype(np.float64), np.concatenate(faces)


def _error_mm(template, frame, vertices):
    fitted = evaluate(template.model, np.zeros(0), frame.pose, frame.translation).vertices
    return 1e3 * float(np.linalg.norm(fitted - vertices, axis=1).mean())


def _largest_turn(before, after):
    return float(np.rad2deg(np.linalg.norm(after - before, axis=1)).max())


def test_follows_the_hand(sequence):
    model, template, _, _, surfaces = sequence
    tracker = Tracker(template, OPTIONS)
    for number, vertices in enumerate(surfaces):
        frame = tracker.step(_scan(str(number), vertices, model.faces), str(number))
        assert frame.status == "ok"
        assert _error_mm(template, frame, vertices) < 1.0
        assert frame.signals["model_seen"] > 0.9


def test_free_vertices_follow_what_the_model_cannot(sequence):
    """A swelling of 4 mm on the palm: the surface goes along, the verdict stays the model's, the pose too."""
    model, template, _, _, surfaces = sequence
    palm = surfaces[0][model.skinning_weights[:, 0] > 0.9]
    middle = palm[np.linalg.norm(palm - palm.mean(axis=0), axis=1).argmin()]
    near = np.exp(-np.sum((surfaces[0] - middle) ** 2, axis=1) / 0.02**2)
    swollen = surfaces[0] + 4e-3 * near[:, None] * vertex_normals(surfaces[0], model.faces)
    scan, many = _scan("0", swollen, model.faces), dataclasses.replace(OPTIONS, samples=16_000)
    frame = Tracker(template, many).step(scan, "0")
    fixed = Tracker(template, dataclasses.replace(many, free_vertices=False)).step(scan, "0")
    assert fixed.offsets is None and fixed.s2m_mm["mean"] == fixed.signals["model_s2m_mm"]
    np.testing.assert_array_equal(frame.pose, fixed.pose)
    assert frame.signals == fixed.signals
    assert frame.s2m_mm["mean"] < 0.5 * fixed.s2m_mm["mean"]
    posed = evaluate(template.model, np.zeros(0), frame.pose, frame.translation).vertices
    errors = [
        np.linalg.norm(found - swollen, axis=1)[near > 0.5].mean() for found in (posed, posed + frame.offsets)
    ]
    assert errors[1] < 0.6 * errors[0]


def test_bad_frames_cost_nothing_but_themselves(sequence):
    model, template, _, _, surfaces = sequence
    tracker = Tracker(template, OPTIONS)
    first = tracker.step(_scan("0", surfaces[0], model.faces), "0")
    missing = tracker.step(None, "1", "NaN in all points")
    assert (missing.status, missing.reason, missing.s2m_mm) == ("failed", "NaN in all points", None)
    np.testing.assert_array_equal(missing.pose, first.pose)
    few = tracker.step(_scan("2", surfaces[2], model.faces[:20]), "2")
    assert few.status == "failed"
    assert "points" in few.reason
    elsewhere = tracker.step(_scan("3", *_wall()), "3")
    assert elsewhere.status == "failed"
    assert "track lost" in elsewhere.reason
    np.testing.assert_array_equal(elsewhere.pose, first.pose)
    back = tracker.step(_scan("4", surfaces[4], model.faces), "4")
    assert back.status == "ok"
    assert _error_mm(template, back, surfaces[4]) < 1.0


def test_missing_fingers_do_not_jump_and_come_back(sequence):
    model, template, _, _, surfaces = sequence
    block = next(b for b in model.pose_blocks if len(b.components))
    fingers = model.skinning_weights[:, list(block.joints)].sum(axis=1) > 0.5
    rest = model.faces[~fingers[model.faces].any(axis=1)]
    tracker, before = Tracker(template, OPTIONS), None
    for number, vertices in enumerate(surfaces):
        lost = 4 <= number < 8
        scan = _scan(str(number), vertices, rest if lost else model.faces)
        if len(scan.points) < OPTIONS.bounds.fewest_points:
            frame = tracker.step(None, str(number))
        else:
            frame = tracker.step(scan, str(number))
        if before is not None:
            assert _largest_turn(before[1:], frame.pose[1:]) < 20
        before = frame.pose
    assert frame.status == "ok"
    assert _error_mm(template, frame, surfaces[-1]) < 1.0


def test_resumes_to_the_last_bit(sequence):
    model, template, _, _, surfaces = sequence
    scans = [_scan(str(n), vertices, model.faces) for n, vertices in enumerate(surfaces[:5])]
    whole, broken = Tracker(template, OPTIONS), Tracker(template, OPTIONS)
    expected = [whole.step(scan, scan.name) for scan in scans]
    for scan in scans[:2]:
        broken.step(scan, scan.name)
    resumed = Tracker(template, OPTIONS, broken.state)
    for scan, wanted in zip(scans[2:], expected[2:], strict=True):
        found = resumed.step(scan, scan.name)
        np.testing.assert_array_equal(found.pose, wanted.pose)
        np.testing.assert_array_equal(found.translation, wanted.translation)


def test_flat_hands_stay_flat_and_components_span_few_directions(sequence):
    model, *_ = sequence
    columns = ModelFields(model, shape_count=0).columns
    block = next(b for b in model.pose_blocks if len(b.components))
    flat = tracking_subspace(model, columns, TrackingOptions(hands="flat"))
    numbers = (columns.pose.start + 3 * np.array(block.joints)[:, None] + np.arange(3)).ravel()
    lifted = flat.lifted(np.ones(flat.directions.shape[1]))
    np.testing.assert_array_equal(lifted[numbers], 0)
    six = tracking_subspace(model, columns, TrackingOptions(hands="components"))
    assert six.directions.shape[1] == columns.count - len(numbers) + 6
    assert tracking_subspace(model, columns, TrackingOptions(hands="full")) is None


def test_unposing_inverts_posing(sequence, rng):
    model, *_ = sequence
    pose = 0.4 * rng.standard_normal((model.joint_count, 3))
    shape, place = rng.standard_normal(4), rng.standard_normal(3)
    # Another skin about the same joints.
    own = 3e-3 * rng.standard_normal(model.template.shape)
    regressor = model.joint_regressor.toarray()
    own -= np.linalg.pinv(regressor) @ (regressor @ own)
    posed = evaluate(dataclasses.replace(model, template=model.template + own), shape, pose, place).vertices
    template = unposed(model, posed, ModelParameters(place, pose, shape))
    shaped = model.template + own + model.shape_directions[:, :, :4] @ shape
    np.testing.assert_allclose(template, shaped, atol=1e-9)


def test_unposing_does_not_enlarge_what_is_off_in_folded_skin(sequence, rng):
    model, *_ = sequence
    pose = np.zeros((model.joint_count, 3))
    pose[next(joint for joint, parent in enumerate(model.parents) if joint and parent), 1] = np.deg2rad(170)
    parameters = ModelParameters(np.zeros(3), pose, np.zeros(0))
    posed = evaluate(model, parameters.shape, pose, parameters.translation).vertices
    off = 3e-3 * rng.standard_normal(posed.shape)
    found = np.linalg.norm(unposed(model, posed + off, parameters) - model.template, axis=1)
    assert (found <= 1.5 * np.linalg.norm(off, axis=1)).all()


def test_template_of_a_person(sequence):
    model, template, poses, places, surfaces = sequence
    frames = [(str(n), _scan(str(n), vertices, model.faces)) for n, vertices in enumerate(surfaces[:4])]
    frames.insert(1, ("gap", None))
    start = ModelParameters(places[0], poses[0], np.zeros(3))
    found = learn_subject_template(iter(frames), model, start, OPTIONS)
    assert found.used == ("0", "1", "2", "3")
    assert set(found.rejected) == {"gap"}
    before = np.linalg.norm(model.template - template.model.template, axis=1).mean()
    after = np.linalg.norm(found.model.template - template.model.template, axis=1).mean()
    assert after < 0.5 * before
    with pytest.raises(TemplateError, match="no frame"):
        learn_subject_template(iter([("gap", None)]), model, start, OPTIONS)


def test_faces_that_are_held_do_not_follow_the_scan(sequence):
    model, _, _, _, surfaces = sequence
    surface = MovingSurface(model.template, model.faces)
    normals = vertex_normals(surfaces[0], model.faces)
    points = FramePoints(surfaces[0] + 2e-3 * normals, normals, 1e-6)
    for held, bounds in ((True, (0.0, 1e-9)), (False, (0.7e-3, 2.1e-3))):
        faces = np.full(len(model.faces), held)
        free = coupled_vertices(surfaces[0], surface, points, OPTIONS, faces, OPTIONS.template_free)
        moved = np.linalg.norm(free - surfaces[0], axis=1).mean()
        assert bounds[0] <= moved <= bounds[1]
