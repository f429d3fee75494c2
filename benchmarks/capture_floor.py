"""How near the open body comes to simulated strangers at best: fitted to their true vertices, not to scans.

    python benchmarks/capture_floor.py CAPTURE TRACKED [--every 30]

CAPTURE is what ``corporeal simulate CAPTURE --body`` wrote, TRACKED what ``corporeal track`` did with it. In
every N-th frame place, pose and all shape numbers are fitted to a seventh of the vertices whose true place is
known, with weak priors, from where the tracking was. Columns, in mm: mean distance of those vertices and of
the hands' to their true places, and of scan points to the fitted surface. What tracking has beyond this is
its own; the rest is the difference between two people's skins.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import scipy.sparse as sp

from corporeal.fitting.files import TEMPLATE, load_subject_template, read_frame
from corporeal.fitting.frame_data import HandFaces
from corporeal.model.files import open_model
from corporeal.model.landmarks import LandmarkSet
from corporeal.model.surface_model import SurfaceModel
from corporeal.registration.options import LandmarkStage
from corporeal.registration.stages import Fitter, MeasuredLandmarks
from corporeal.registration.subjects import BODY
from corporeal.registration.target import Target
from corporeal.scans.files import read_scan
from corporeal.terms.model_fields import ModelParameters

EVERY_VERTEX = 7
STAGE = LandmarkStage(sigma=0.01, robust_scale=1e3, iterations=80, pose_prior_scale=3.0)


def nearest(
    model: SurfaceModel, sequence: Path, name: str, start: ModelParameters
) -> tuple[float, float, float]:
    """A row: body, hands, scan to model."""
    with np.load(sequence / "truth" / f"{name}.npz", allow_pickle=False) as truth:
        places, placed = truth["template"].astype(float), truth["placed"]
    picked = np.flatnonzero(placed)[::EVERY_VERTEX]
    shape = (len(picked), model.vertex_count + model.joint_count)
    weights = sp.csr_matrix((np.ones(len(picked)), (np.arange(len(picked)), picked)), shape=shape)
    names = tuple(f"vertex {vertex}" for vertex in picked)
    marks = LandmarkSet(names, weights, model.vertex_count)
    target = Target(read_scan(sequence / "scans" / f"{name}.ply", "mm", BODY.extent))
    fitter = Fitter(
        model, target, MeasuredLandmarks(marks, places[picked], np.ones(len(picked))), BODY.options()
    )
    vector = fitter.fit_landmarks(start.vector(), STAGE).state.parameters
    vertices = fitter.fields.evaluated(vector).vertices
    mm = 1e3 * np.linalg.norm(vertices - places, axis=1)
    hands = np.zeros(model.vertex_count, dtype=bool)
    hands[np.unique(model.faces[HandFaces.of_model(model).any_hand(len(model.faces))])] = True
    closest = fitter.surface.closest(vertices, target.samples.positions, None)
    return mm[placed].mean(), mm[placed & hands].mean(), 1e3 * closest.distances.mean()


def main() -> None:
    """Print a row per sequence."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("capture", type=Path)
    parser.add_argument("tracked", type=Path)
    parser.add_argument("--every", type=int, default=30)
    asked = parser.parse_args()
    model, rows = open_model("body"), []
    print(f"{'':16} {'body':>6} {'hands':>6} {'s2m':>6}")
    for tracked in sorted(path.parent for path in asked.tracked.glob(f"*/{TEMPLATE}")):
        sequence, shape = asked.capture / tracked.name, load_subject_template(tracked).shape
        found = []
        for path in sorted((tracked / "frames").glob("*.npz"))[:: asked.every]:
            frame = read_frame(path).frame
            start = ModelParameters(frame.translation, frame.pose, shape)
            found.append(nearest(model, sequence, frame.name, start))
        rows += found
        print(
            f"{sequence.name:16} " + " ".join(f"{mean:6.2f}" for mean in np.mean(found, axis=0)), flush=True
        )
    print(f"{'all':16} " + " ".join(f"{mean:6.2f}" for mean in np.mean(rows, axis=0)))


if __name__ == "__main__":
    main()
