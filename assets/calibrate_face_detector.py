"""Where the 2D detector sees its landmarks on the open body's face: the landmark set "face_51_detector".

As `calibrate_detector.py` does for the hand. The set lies in a file of its own, by the body's vertices:

    python assets/calibrate_face_detector.py [--samples 40] [--output FILE]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import scipy.sparse as sp
from calibrate_body_detector import symmetric
from calibrate_detector import fit_rows

from corporeal.geometry.normals import vertex_normals
from corporeal.model.files import open_model
from corporeal.model.heads import DETECTED, HEAD_PARTS, head_of
from corporeal.model.jacobian import Evaluated, evaluate
from corporeal.model.landmarks import LandmarkSet
from corporeal.model.surface_model import SurfaceModel
from corporeal.scans.face_detector import FACE_NAMES, FaceDetector
from corporeal.scans.face_landmarks import find_face_landmarks
from corporeal.scans.scan import Scan, Unit

OUTPUT = Path(__file__).resolve().parents[1] / "src/corporeal/model/open_models/face_detector.npz"
_CANDIDATES = 40
# Of a head's shape numbers: 25 of identity, then expressions, of which the first 10 are drawn.
_SPREAD = np.concatenate([np.ones(25), np.full(10, 0.5), np.zeros(30)])


def sample(model: SurfaceModel, generator: np.random.Generator) -> Evaluated:
    """A face of any shape and of half an expression, its jaw a little open."""
    pose = np.zeros((model.joint_count, 3))
    pose[1] = 0.1 * generator.normal(size=3)
    pose[2, 0] = generator.uniform(0, 0.2)
    shape = _SPREAD[: model.shape_count] * generator.normal(size=model.shape_count)
    return evaluate(model, shape, pose, np.zeros(3))


def calibrate(model: SurfaceModel, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows (51, V) over the head's vertices, and the residuals (51,) over the samples in metres."""
    generator = np.random.default_rng(seed)
    anchors, observed = [], []
    with FaceDetector() as detector:
        for _ in range(count):
            posed = sample(model, generator)
            normals = vertex_normals(posed.vertices, model.faces)
            scan = Scan("model", posed.vertices, model.faces, normals, None, Unit("m", 1.0))
            found = find_face_landmarks(scan, detector)
            if found.ok:
                anchors.append(posed.vertices)
                observed.append(found.points)
    print(f"the detector saw {len(observed)} of {count} samples")
    return fit_rows(np.array(observed), np.array(anchors), _CANDIDATES)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--samples", type=int, default=40)
    parser.add_argument("--output", type=Path, default=OUTPUT)
    options = parser.parse_args()
    body = open_model("body")
    head = head_of(body)
    rows, residuals = calibrate(head, options.samples, seed=0)
    over_joints = sp.csr_matrix((len(rows), head.joint_count))
    weights = sp.hstack([sp.csr_matrix(rows), over_joints]).tocsr()
    seen = LandmarkSet(FACE_NAMES, weights, head.vertex_count)
    table = symmetric(head.replace(landmarks={DETECTED: seen}), DETECTED).landmarks[DETECTED].weights
    kept = np.unique(np.concatenate([body.parts[part] for part in HEAD_PARTS]))
    np.savez_compressed(
        options.output,
        names=np.array(FACE_NAMES),
        starts=table.indptr.astype(np.int32),
        vertices=kept[table.indices].astype(np.int32),
        weights=table.data,
        vertex_count=np.array(body.vertex_count),
    )
    for name, residual in zip(FACE_NAMES, residuals, strict=True):
        print(f"{name:26} median residual {1e3 * residual:.1f} mm")


if __name__ == "__main__":
    main()
