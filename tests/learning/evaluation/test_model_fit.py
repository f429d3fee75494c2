"""A model alone fitted to scans whose pose and shape are known."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from corporeal.learning.evaluation.model_fit import ModelFitter, fit_model
from corporeal.learning.evaluation.protocols import PoseAndShape, PoseOnly
from corporeal.model.files import open_model
from corporeal.model.jacobian import evaluate
from corporeal.model.surface_model import CutPlane
from corporeal.terms.model_fields import ModelParameters


def test_the_full_pose_reaches_the_noise(bent_tube, tube_scan, personal):
    s2m, v2v = [], []
    for seed in range(1, 5):
        known = tube_scan(seed)
        model = personal(bent_tube, known.true)
        fit = fit_model(model, known.scan, known.start(model, PoseOnly()), PoseOnly())
        assert fit.status == "ok" and fit.parameters.shape.shape == (0,)
        assert fit.s2m_mm["p95"] < 0.25
        s2m.append(fit.s2m_mm["mean"])
        fitted = evaluate(model, np.zeros(0), fit.parameters.pose, fit.parameters.translation).vertices
        true = evaluate(bent_tube, known.true.shape, known.true.pose, known.true.translation).vertices
        v2v.append(np.linalg.norm(fitted - true, axis=1).mean())
    # Half-normal: the mean distance of noise of 0.1 mm is 0.08 mm. Of several scans: one alone ends 0.008 mm
    # lower or higher by the last bit of a normal, since pairs of points come and go with it.
    assert np.mean(s2m) < 0.09 and np.mean(v2v) < 1e-4


def test_the_objective_falls_with_the_components_and_poses_lie_in_them(bent_tube, tube_scan, personal):
    known = tube_scan(2)
    model = personal(bent_tube, known.true)
    fits, full = ModelFitter(model, known.scan, known.start(model, PoseOnly()), PoseOnly()).fit_all(range(7))
    objectives = [fit.objective for fit in [*fits, full]]
    assert np.all(np.diff(objectives) <= 0)
    assert fits[0].s2m_mm["mean"] > 3 * fits[6].s2m_mm["mean"]
    # Six components hold every pose of the two joints.
    assert fits[6].s2m_mm["mean"] == pytest.approx(full.s2m_mm["mean"], rel=0.05)
    block = model.block("pose")
    for fit in fits:
        coefficients = block.components @ (fit.parameters.pose[1:].ravel() - block.mean)
        assert np.abs(coefficients[fit.components :]).max(initial=0) < 1e-9


def test_correctives_count_and_can_be_left_out(bent_tube, tube_scan, personal):
    known = tube_scan(3)
    model = personal(bent_tube, known.true)
    on, off = (
        fit_model(model, known.scan, known.start(model, PoseOnly()), PoseOnly(), correctives=correctives)
        for correctives in (True, False)
    )
    assert off.s2m_mm["mean"] > 1.5 * on.s2m_mm["mean"]


def test_a_free_shape_is_found_from_the_template(bent_tube, tube_scan):
    known = tube_scan(4)
    fit = fit_model(bent_tube, known.scan, known.start(bent_tube, PoseAndShape()), PoseAndShape())
    assert fit.s2m_mm["mean"] < 0.12
    assert np.abs(fit.parameters.shape - known.true.shape).max() < 0.3
    few = fit_model(
        bent_tube,
        known.scan,
        known.start(bent_tube, PoseAndShape(shape_count=1)),
        PoseAndShape(shape_count=1),
    )
    assert few.parameters.shape.shape == (1,) and few.s2m_mm["mean"] > fit.s2m_mm["mean"]


def test_a_protocol_that_the_model_does_not_suit_is_refused(bent_tube, tube_scan):
    known = tube_scan(5)
    start = known.start(bent_tube, PoseAndShape())
    with pytest.raises(ValueError, match="personal model"):
        fit_model(bent_tube, known.scan, dataclasses.replace(start, shape=np.zeros(0)), PoseOnly())
    with pytest.raises(ValueError, match="start: shape"):
        fit_model(bent_tube, known.scan, dataclasses.replace(start, shape=np.zeros(2)), PoseAndShape())
    with pytest.raises(ValueError, match="expected 0 to 6"):
        fit_model(bent_tube, known.scan, start, PoseAndShape(), components=7)
    with pytest.raises(ValueError, match="ascending"):
        ModelFitter(bent_tube, known.scan, start, PoseAndShape()).fit_all([2, 1])


def test_a_scan_behind_the_cut_plane_fails_and_says_so(bent_tube, tube_scan):
    known = tube_scan(6)
    model = bent_tube.replace(cut=CutPlane(0, np.zeros(3), np.array([-1.0, 0, 0])))
    start = known.start(model, PoseAndShape())
    kept_side = Rotation.from_rotvec(start.pose[0]).apply([-1, 0, 0])
    away = dataclasses.replace(start, translation=start.translation + kept_side)
    fits, full = ModelFitter(model, known.scan, away, PoseAndShape()).fit_all([2])
    for fit in (*fits, full):
        assert fit.status == "failed" and "wrist" in fit.reason and not fit.s2m_mm
    near = fit_model(model, known.scan, start, PoseAndShape(), components=2)
    assert near.status == "ok" and near.s2m_mm["scored_share"] > 0.9


def test_points_before_the_cut_plane_are_not_scored(bent_tube, tube_scan, personal):
    known = tube_scan(7)
    model = personal(bent_tube, known.true)
    cut_model = model.replace(cut=CutPlane(0, np.array([-0.02, 0, 0]), np.array([-1.0, 0, 0])))
    along = (known.scan.points - known.scan.points.mean(axis=0)) @ Rotation.from_rotvec(
        known.true.pose[0]
    ).apply([-1, 0, 0])
    points = known.scan.points.copy()
    points[along < np.quantile(along, 0.1)] += 5.0
    spoiled = dataclasses.replace(known.scan, points=points)
    start = known.start(model, PoseOnly())
    assert fit_model(model, spoiled, start, PoseOnly()).s2m_mm["mean"] > 100
    assert fit_model(cut_model, known.scan, start, PoseOnly()).s2m_mm["mean"] < 0.09


@pytest.mark.slow
def test_the_hand_in_the_box(make_scan, personal):
    hand = open_model("hand")
    block = hand.block("hand")
    rng = np.random.default_rng(8)
    pose = np.concatenate([rng.normal(size=(1, 3)), 0.6 * block.mixture.means[0].reshape(-1, 3)])
    true = ModelParameters(rng.normal(scale=0.3, size=3), pose, 0.8 * rng.normal(size=hand.shape_count))
    known = make_scan(hand, true, 8, 2e-4)
    own = personal(hand, true)
    fits, full = ModelFitter(own, known.scan, known.start(own, PoseOnly()), PoseOnly()).fit_all([6])
    # Half-normal: the mean distance of noise of 0.2 mm is 0.16 mm.
    assert full.s2m_mm["mean"] < 0.19 < fits[0].s2m_mm["mean"]
    free = fit_model(hand, known.scan, known.start(hand, PoseAndShape()), PoseAndShape())
    assert free.s2m_mm["mean"] < 0.2
