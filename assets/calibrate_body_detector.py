"""Where the 2D detectors see their landmarks on the open body: its landmark set "body_75_detector".

As `calibrate_detector.py` does for the hand: the body is rendered in many shapes and poses through the same
virtual cameras that look at scans, MediaPipe's 33 landmarks are triangulated, and each becomes a sparse,
non-negative combination of nearby vertices and joints, averaged with its mirror image. The 42 of the hands
are those of the hand's own calibration, which the body holds already.

    python assets/calibrate_body_detector.py [--samples 40] [--body FILE]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import scipy.sparse as sp
from calibrate_detector import fit_rows
from scipy.spatial.transform import Rotation

from corporeal.geometry.normals import vertex_normals
from corporeal.model.files import load_model, save_model
from corporeal.model.jacobian import Evaluated, evaluate
from corporeal.model.landmarks import LandmarkSet
from corporeal.model.mirror import mirror_model
from corporeal.model.surface_model import SurfaceModel
from corporeal.scans.body_detector import BODY_NAMES, BodyDetector
from corporeal.scans.body_landmarks import find_body_landmarks
from corporeal.scans.detector import HandDetector
from corporeal.scans.scan import Scan, Unit

BODY = Path(__file__).resolve().parents[1] / "src/corporeal/model/open_models/body.npz"
SET_NAME = "body_75_detector"
_CANDIDATES = 80


def sample(model: SurfaceModel, generator: np.random.Generator) -> Evaluated:
    """A person as people stand before a scanner: arms half down to half up, joints a little bent."""
    pose = np.zeros((model.joint_count, 3))
    for side, sign in (("left", -1.0), ("right", 1.0)):
        pose[model.joint_names.index(f"{side}_shoulder"), 2] = sign * generator.uniform(-0.3, 1.2)
        pose[model.joint_names.index(f"{side}_elbow"), 1] = sign * generator.uniform(0, 1.0)
        pose[model.joint_names.index(f"{side}_knee"), 0] = generator.uniform(0, 0.6)
    pose[1:22] += 0.1 * generator.normal(size=(21, 3))
    pose[0] = Rotation.from_euler("y", generator.uniform(0, 2 * np.pi)).as_rotvec()
    return evaluate(model, generator.normal(size=model.shape_count), pose, np.zeros(3))


def calibrate(model: SurfaceModel, count: int, seed: int) -> tuple[LandmarkSet, np.ndarray]:
    """The landmark set, and the residuals (33,) of its body points over the samples in metres."""
    generator = np.random.default_rng(seed)
    anchors, observed = [], []
    with BodyDetector() as bodies, HandDetector() as hands:
        for _ in range(count):
            posed = sample(model, generator)
            normals = vertex_normals(posed.vertices, model.faces)
            scan = Scan("model", posed.vertices, model.faces, normals, None, Unit("m", 1.0))
            found = find_body_landmarks(scan, bodies, hands)
            if found.ok:
                anchors.append(np.concatenate([posed.vertices, posed.joints]))
                observed.append(found.points[: len(BODY_NAMES)])
    print(f"the detector saw {len(observed)} of {count} samples")
    rows, residuals = fit_rows(np.array(observed), np.array(anchors), _CANDIDATES)
    hands_rows = [model.landmarks[f"{side}_hand_21_detector"] for side in ("left", "right")]
    names = (*BODY_NAMES, *(name for known in hands_rows for name in known.names))
    weights = sp.vstack([sp.csr_matrix(rows), *(known.weights for known in hands_rows)])
    return LandmarkSet(names, sp.csr_matrix(weights), model.vertex_count), residuals


def symmetric(model: SurfaceModel, name: str) -> SurfaceModel:
    """The model with a set averaged with its mirror image: the samples' noise is not the body's shape."""
    ours, image = model.landmarks[name], mirror_model(model).landmarks[name]
    weights = sp.csr_matrix(0.5 * (ours.weights + image.weights))
    averaged = LandmarkSet(ours.names, weights, model.vertex_count)
    return model.replace(landmarks={**model.landmarks, name: averaged})


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--samples", type=int, default=40)
    parser.add_argument("--body", type=Path, default=BODY)
    options = parser.parse_args()
    model = load_model(options.body)
    landmark_set, residuals = calibrate(model, options.samples, seed=0)
    calibrated = symmetric(model.replace(landmarks={**model.landmarks, SET_NAME: landmark_set}), SET_NAME)
    save_model(calibrated, options.body, precision="float16")
    for name, residual in zip(BODY_NAMES, residuals, strict=True):
        print(f"{name:20} median residual {1e3 * residual:.1f} mm")


if __name__ == "__main__":
    main()
