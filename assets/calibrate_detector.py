"""Where the 2D detector sees its landmarks on our hand: a landmark set of its own, "hand_21_detector".

A detector's idea of a landmark is not a rig's joint. The model is rendered in many shapes and poses through
the same virtual cameras that look at scans, its landmarks are triangulated, and each becomes a sparse,
non-negative combination of nearby vertices and joints that follows them.

    python assets/calibrate_detector.py [--samples 60]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import scipy.sparse as sp
from scipy.optimize import nnls
from scipy.spatial.transform import Rotation

from corporeal.geometry.normals import vertex_normals
from corporeal.geometry.topology import boundary_loops
from corporeal.model.files import load_model, save_model
from corporeal.model.jacobian import Evaluated, evaluate
from corporeal.model.landmarks import LandmarkSet
from corporeal.model.surface_model import SurfaceModel
from corporeal.scans.detector import LANDMARK_NAMES, HandDetector
from corporeal.scans.landmarks import find_hand_landmarks
from corporeal.scans.scan import Scan, Unit

HAND = Path(__file__).resolve().parents[1] / "src/corporeal/model/open_models/hand.npz"
SET_NAME = "hand_21_detector"
_CANDIDATES = 60
_RIDGE = 2e-3
_ARM = 0.10  # metres


def sample(model: SurfaceModel, generator: np.random.Generator) -> Evaluated:
    """A hand as people show it to a scanner: nearly flat to half closed, of any shape, turned at random."""
    block = model.block("hand")
    means = block.mixture.means if block.mixture is not None else block.mean[None]
    share = generator.uniform(0, 0.5)
    pose = np.zeros((model.joint_count, 3))
    pose[list(block.joints)] = (share * means[generator.integers(len(means))]).reshape(-1, 3)
    pose[1:] += 0.06 * generator.normal(size=(model.joint_count - 1, 3))
    pose[0] = Rotation.random(random_state=int(generator.integers(1 << 30))).as_rotvec()
    return evaluate(model, 0.8 * generator.normal(size=model.shape_count), pose, np.zeros(3))


def with_arm(model: SurfaceModel, posed: Evaluated) -> tuple[np.ndarray, np.ndarray]:
    """The posed surface, drawn out from its opening into a stump of an arm, as scans have one.

    The detector sees a hand that ends at the wrist less often, and its wrist elsewhere.
    """
    loop = boundary_loops(model.faces)[0]
    outward = -posed.T_world_joint[model.cut.joint, :3, :3] @ model.cut.normal
    ring = np.arange(len(loop)) + len(posed.vertices)
    following, ring_following = np.roll(loop, -1), np.roll(ring, -1)
    wall = [np.stack([following, loop, ring], axis=1), np.stack([following, ring, ring_following], axis=1)]
    vertices = np.concatenate([posed.vertices, posed.vertices[loop] + _ARM * outward])
    return vertices, np.concatenate([model.faces, *wall])


def observe(model: SurfaceModel, posed: Evaluated, detector: HandDetector) -> np.ndarray | None:
    """The landmarks (21, 3) that the detector sees on a posed model, metres; None where it does not."""
    vertices, faces = with_arm(model, posed)
    scan = Scan("model", vertices, faces, vertex_normals(vertices, faces), None, Unit("m", 1.0))
    found = find_hand_landmarks(scan, detector)
    return found.points if found.ok and found.side_score > 0.5 else None


def fit_row(points: np.ndarray, anchors: np.ndarray, near: np.ndarray) -> np.ndarray:
    """Non-negative weights of the anchors (samples, A, 3) that give a landmark's points (samples, 3)."""
    strict = 10.0
    A = anchors[:, near].transpose(0, 2, 1).reshape(-1, len(near))
    system = np.vstack([A, np.full((1, len(near)), strict), _RIDGE * np.eye(len(near))])
    right = np.concatenate([points.ravel(), [strict], np.zeros(len(near))])
    weights, _ = nnls(system, right)
    weights[weights < 1e-3 * weights.max()] = 0
    row = np.zeros(anchors.shape[1])
    row[near] = weights / weights.sum()
    return row


def fit_rows(points: np.ndarray, anchors: np.ndarray, candidates: int) -> tuple[np.ndarray, np.ndarray]:
    """A row (A,) per landmark of ``points`` (samples, N, 3), and the median distances (N,) that are left."""
    rows, residuals = [], []
    for k in range(points.shape[1]):
        distance = np.median(np.linalg.norm(anchors - points[:, k, None], axis=2), axis=0)
        near = np.argsort(distance)[:candidates]
        row = fit_row(points[:, k], anchors, near)
        error = np.linalg.norm(np.einsum("a,sac->sc", row, anchors) - points[:, k], axis=1)
        good = error < 2.5 * np.median(error)  # a sample whose views agreed on the wrong finger
        rows.append(fit_row(points[good, k], anchors[good], near))
        residuals.append(np.median(error[good]))
    return np.array(rows), np.array(residuals)


def calibrate(model: SurfaceModel, count: int, seed: int) -> tuple[LandmarkSet, np.ndarray]:
    """The landmark set, and its residuals (21,) over the samples in metres."""
    generator = np.random.default_rng(seed)
    anchors, observed = [], []
    with HandDetector() as detector:
        for _ in range(count):
            posed = sample(model, generator)
            points = observe(model, posed, detector)
            if points is not None:
                anchors.append(np.concatenate([posed.vertices, posed.joints]))
                observed.append(points)
    print(f"the detector saw {len(observed)} of {count} samples")
    rows, residuals = fit_rows(np.array(observed), np.array(anchors), _CANDIDATES)
    return LandmarkSet(LANDMARK_NAMES, sp.csr_matrix(rows), model.vertex_count), residuals


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--samples", type=int, default=60)
    parser.add_argument("--hand", type=Path, default=HAND)
    options = parser.parse_args()
    model = load_model(options.hand)
    landmark_set, residuals = calibrate(model, options.samples, seed=0)
    landmarks = {**model.landmarks, SET_NAME: landmark_set}
    save_model(model.replace(landmarks=landmarks), options.hand, precision="float16")
    for name, residual in zip(LANDMARK_NAMES, residuals, strict=True):
        print(f"{name:12} median residual {1e3 * residual:.1f} mm")


if __name__ == "__main__":
    main()
