"""Captures of the open hand whose truth is known."""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from corporeal.geometry.normals import vertex_normals
from corporeal.model.files import open_model
from corporeal.model.jacobian import evaluate
from corporeal.registration.evidence import LandmarkEvidence
from corporeal.registration.starts import turned
from corporeal.scans.scan import Scan, Unit

SET_NAME = "hand_21_mediapipe"


@dataclass(frozen=True)
class Capture:
    scan: Scan
    vertices: np.ndarray
    joints: np.ndarray
    evidence: LandmarkEvidence


@pytest.fixture(scope="session")
def hand():
    return open_model("hand")


def capture(
    model, seed, *, noise=0.2e-3, landmark_noise=3e-3, right_probability=0.99, shape_spread=0.8, bend=0.5
):
    """A posed hand of random shape and place, its surface noisy, with a hole on the back."""
    rng = np.random.default_rng(seed)
    block = model.block("hand")
    pose = np.zeros((model.joint_count, 3))
    # Half way to a recorded kind of pose: whole fists press fingers into the palm, no scanner sees that.
    means = block.mixture.means
    pose[list(block.joints)] = bend * means[seed % len(means)].reshape(-1, 3)
    shape = shape_spread * rng.normal(size=model.shape_count)
    R, t = Rotation.random(random_state=seed).as_matrix(), rng.normal(scale=0.3, size=3)
    vector = turned(model, pose, shape, R, t)
    posed = evaluate(model, shape, vector[3 : 3 + pose.size].reshape(-1, 3), vector[:3])
    points = posed.vertices + rng.normal(scale=noise, size=posed.vertices.shape)
    centre = points[model.parts["palm"]][len(model.parts["palm"]) // 2]
    kept = np.linalg.norm(points - centre, axis=1) > 8e-3
    scan = Scan(
        "capture", points, model.faces, vertex_normals(points, model.faces), None, Unit("mm", 1e-3)
    ).subset(kept)
    landmark_set = model.landmarks[SET_NAME]
    marks = landmark_set.positions(posed.vertices, posed.joints)
    marks = marks + rng.normal(scale=landmark_noise, size=marks.shape)
    evidence = LandmarkEvidence(
        dict(zip(landmark_set.names, marks, strict=True)), {}, right_probability, SET_NAME
    )
    return Capture(scan, posed.vertices, posed.joints, evidence)


@pytest.fixture(scope="session")
def make_capture():
    return capture
