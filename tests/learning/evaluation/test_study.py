"""Which curves are compared, which ratios come of them, and what is said of them."""

import dataclasses

import numpy as np
import pytest

from corporeal.geometry.normals import vertex_normals
from corporeal.learning.evaluation.held_out import held_out, personal_models
from corporeal.learning.evaluation.pose_generalisation import HeldOutScan
from corporeal.learning.evaluation.results import PoseCurve, ScanError, ScanResult, Summary
from corporeal.learning.evaluation.study import (
    LearnedVariant,
    Study,
    compared_curves,
    evaluated,
    localities,
    pose_and_shape_free,
    pose_only,
)
from corporeal.learning.evaluation.variants import planned_variants
from corporeal.learning.learn import learn_model
from corporeal.learning.options import LearningOptions
from corporeal.scans.scan import Scan, Unit

SHORT = LearningOptions(sweeps=3)


def curve(label, protocol, errors):
    scans = [
        ScanResult(f"scan{number}", f"s{number % 3}", "ok", (), ScanError(error, error, error))
        for number, error in enumerate(errors)
    ]
    return PoseCurve(label, protocol, (), (), (), len(scans), 3, Summary.of(np.array(errors)), tuple(scans))


@pytest.fixture(scope="module")
def study(known_tube):
    """A tube learned from six people, both variants that one side allows, and two other people."""
    people = np.array(known_tube.training.subjects)
    training = known_tube.training.subset(people < "s06")
    learned = learn_model(training, known_tube.start, SHORT)
    variants = [
        LearnedVariant(variant, learn_model(variant.training, known_tube.start, variant.options))
        for variant in planned_variants(training, "right", SHORT)[0]
    ]
    others = known_tube.training.subset(people >= "s06")
    poses = tuple("natural" if number % 11 == 10 else "" for number in range(len(others)))
    session = held_out(dataclasses.replace(others, protocol_poses=poses), "natural")
    scans = []
    for index in session.scored:
        points, faces = others.vertices[index], known_tube.start.faces
        scan = Scan(others.names[index], points, faces, vertex_normals(points, faces), None, Unit("m", 1.0))
        scans.append(
            HeldOutScan(
                scan.name, others.subjects[index], others.hands[index], scan, others.poses[index], points
            )
        )
    return Study(learned, session, scans, personal_models(learned.model, session), known_tube.start, variants)


def test_ratios_are_taken_within_a_protocol_and_where_both_curves_are_there():
    curves = [
        curve("learned", "pose only", [0.4, 0.6, 0.5]),
        curve("learned, correctives off", "pose only", [1.0, 1.0, 1.0]),
        curve("learned", "pose and shape free", [0.9, 0.9, 0.9]),
        curve("crude start", "pose and shape free", [2.0, 2.0, 2.0]),
        curve("asset start", "pose and shape free", [1.0, 1.0, 1.0]),
    ]
    ratios, notes = compared_curves(curves)
    found = {ratio.name: (ratio.value, ratio.met, ratio.protocol) for ratio in ratios}
    assert found == {
        "correctives on / off": (pytest.approx(0.5), True, "pose only"),
        "learned / crude start": (pytest.approx(0.45), False, "pose and shape free"),
        "learned / asset start": (pytest.approx(0.9), False, "pose and shape free"),
    }
    assert notes == ()


def test_curves_without_a_common_scan_are_noted():
    failed = curve("learned, correctives off", "pose only", [1.0])
    scans = tuple(dataclasses.replace(scan, status="failed: x") for scan in failed.scans)
    ratios, notes = compared_curves(
        [curve("learned", "pose only", [0.5]), dataclasses.replace(failed, scans=scans)]
    )
    assert ratios == ()
    assert "no scan in common" in notes[0]


@pytest.mark.slow
def test_what_is_compared(study, known_tube):
    fixed = {model.label: model for model in pose_only(study)}
    assert set(fixed) == {
        "learned", "learned, correctives off", "learned without correctives", "constant regularisation",
        "learned without equation 11",
    }  # fmt: skip
    assert [model.correctives for model in fixed.values()] == [True, False, True, True, True]
    assert fixed["learned"].components == (1, 2, 3, 6)
    for hand in study.session.hands:
        on, off = (fixed[label].models[hand] for label in ("learned", "learned, correctives off"))
        assert on.template is off.template
        assert not fixed["learned without correctives"].models[hand].has_correctives
    free = {model.label: model for model in pose_and_shape_free(study)}
    assert set(free) == {"learned", "asset start", "crude start"}
    assert free["asset start"].models["s06/right"] is known_tube.start
    assert set(pose_and_shape_free(dataclasses.replace(study, start=None))[0].models) == set(
        study.session.hands
    )
    other = known_tube.start.replace(name="before")
    free = {m.label: m for m in pose_and_shape_free(dataclasses.replace(study, asset=other))}
    assert set(free) == {"learned", "asset start", "crude start", "start"}
    assert free["asset start"].models["s06/right"] is other
    assert free["start"].models["s06/right"] is known_tube.start
    assert free["crude start"].models["s06/right"].name == "before_crude", "no scan has shaped it"


@pytest.mark.slow
def test_correctives_are_more_local_with_geodesic_costs(study):
    shares = {(entry.label, entry.weighting): entry.share for entry in localities(study)}
    assert len(shares) == 4
    assert shares["learned", "plain"] < shares["constant regularisation", "plain"]


@pytest.mark.slow
def test_a_whole_study(study):
    """The learned tube is better than its start, its correctives explain, and nothing is left out."""
    told = []
    results = evaluated(study, 1, lambda protocol, done, count: told.append((protocol, done, count)))
    assert {(entry.label, entry.space) for entry in results.compactness} == {
        ("learned", "pose"), ("learned", "shape"),
    }  # fmt: skip
    by_name = {ratio.name: ratio for ratio in results.ratios}
    assert len(by_name) == 6 and "mirrored / right only" not in by_name
    assert by_name["correctives on / off"].value < 0.9
    assert by_name["learned with / without correctives"].value < 1
    assert by_name["learned / asset start"].met
    learned = results.pose_generalisation[0]
    assert (learned.label, learned.limit, learned.n_scans) == ("learned", 0.6, 2)
    assert results.pose_generalisation[1].limit is None
    assert results.shape_generalisation[0].n_subjects == 6
    assert told[-1] == ("pose and shape free", 6, 6) and ("pose only", 10, 10) in told
    assert any("full pose space" in note for note in results.notes)
    assert results.to_json()["pose_generalisation"][0]["limit"] == 0.6
