"""Points of the body's surface by name: face, ears, toes and heels, written to open_body/surface_points.csv.

The 68 points of the face are where MediaPipe's face detector sees them on a picture of the body with painted
eyes; left and right are averaged. Toes, heels and ears are found by shape. They are corners and weights of
triangles, so that they stay where they are when the model is built again: run this only after a change of
mesh. It needs the extra `detect`.

    python assets/mark_body.py [--body FILE]
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path

import numpy as np
from open_body.face_names import FACE_68, MEDIAPIPE_OF_68, other_side

from corporeal.export.shading import soft_shaded
from corporeal.geometry.cameras import Pinhole
from corporeal.geometry.closest_points import SurfaceTree
from corporeal.geometry.normals import vertex_normals
from corporeal.geometry.rasteriser import Raster, rasterise
from corporeal.model.files import load_model
from corporeal.model.surface_model import SurfaceModel

REPOSITORY = Path(__file__).resolve().parents[1]
BODY = REPOSITORY / "src/corporeal/model/open_models/body.npz"
OUT = REPOSITORY / "assets/open_body/surface_points.csv"
_SIZE, _VIEW, _DISTANCE = 1200, 0.3, 1.2
_SKIN, _WHITE, _IRIS = (0.85, 0.65, 0.55), (0.95, 0.95, 0.95), (0.12, 0.08, 0.06)
_IRIS_RADIUS = 0.0065
# Pixels round a landmark, and how far behind the nearest of them another may lie, metres.
_GAP, _GAP_DEPTH = 12, 0.006
MIRROR = np.array([-1.0, 1.0, 1.0])


def painted(model: SurfaceModel) -> np.ndarray:
    """Colours (V, 3): white eyeballs with irises, without which the detector takes the eyes for closed."""
    colours = np.tile(_SKIN, (model.vertex_count, 1))
    joints = model.joint_regressor @ model.template
    for name in ("left_eye_smplhf", "right_eye_smplhf"):
        joint = model.joint_names.index(name)
        ball = model.skinning_weights[:, joint] > 0.5
        offset = model.template - joints[joint]
        iris = ball & (np.hypot(offset[:, 0], offset[:, 1]) < _IRIS_RADIUS) & (offset[:, 2] > 0)
        colours[ball], colours[iris] = _WHITE, _IRIS
    return colours


def face_points(model: SurfaceModel) -> dict[str, np.ndarray]:
    """The 68 points (3,) on the surface, metres, left and right averaged.

    Raises:
        ValueError: the detector sees no face.
    """
    from mediapipe.python.solutions.face_mesh import FaceMesh

    joints = model.joint_regressor @ model.template
    middle = joints[[model.joint_names.index(f"{side}_eye_smplhf") for side in ("left", "right")]].mean(0)
    target = middle - [0, 0.02, 0]
    camera = Pinhole.look_at(target + [0, 0, _DISTANCE], target, np.array([0.0, 1, 0]), _VIEW, (_SIZE, _SIZE))
    raster = rasterise(model.template, model.faces, camera)
    normals = vertex_normals(model.template, model.faces)
    picture = soft_shaded(raster, model.faces, normals, painted(model), (1.0, 1.0, 1.0))
    with FaceMesh(static_image_mode=True, refine_landmarks=True, min_detection_confidence=0.3) as detector:
        found = detector.process((255 * picture).astype(np.uint8)).multi_face_landmarks
    if not found:
        raise ValueError("the detector sees no face on the model")
    seen = dict(zip(FACE_68, (found[0].landmark[k] for k in MEDIAPIPE_OF_68), strict=True))
    places = {}
    for name, mark in seen.items():
        other = seen[other_side(name)]
        # The camera stands in the mirror plane: both sides are averaged in the picture.
        x, y = _SIZE * (mark.x + 1 - other.x) / 2, _SIZE * (mark.y + other.y) / 2
        places[name] = _on_surface(model, raster, x, y)
    return places


def _on_surface(model: SurfaceModel, raster: Raster, x: float, y: float) -> np.ndarray:
    """The point that the nearest pixel sees that is no gap: between the lips one looks into the mouth."""
    rows, columns = np.nonzero(raster.covered)
    squared = (columns + 0.5 - x) ** 2 + (rows + 0.5 - y) ** 2
    depth = raster.depth[rows, columns]
    near = squared < max(_GAP**2, 1.0001 * squared.min())
    front = near & (depth < depth[near].min() + _GAP_DEPTH)
    nearest = np.argmin(np.where(front, squared, np.inf))
    pixel = rows[nearest], columns[nearest]
    return raster.barycentric[pixel] @ model.template[model.faces[raster.face[pixel]]]


def body_points(model: SurfaceModel) -> dict[str, np.ndarray]:
    """Nose, front of the eyes, ears, toes and heels of the right side, and their mirror images."""
    template, joints = model.template, model.joint_regressor @ model.template
    name = model.joint_names.index
    foot, head = model.parts["right_foot"], model.parts["head"]
    low = foot[template[foot, 1] < template[foot, 1].min() + 0.035]
    toes = template[low]
    # The small toe is foremost in a direction that looks outward, the big toe in one that looks inward.
    right = {
        "big_toe": toes[np.argmax(toes @ [0.35, 0, 1.0])],
        "small_toe": toes[np.argmax(toes @ [-1.0, 0, 0.75])],
        "heel": toes[np.argmin(toes[:, 2])],
        "eye_front": joints[name("right_eye_smplhf")] + [0, 0, 0.0125],
        # The ear's canal: behind and below the eye, at the side of the skull.
        "ear": template[head[np.argmin(np.linalg.norm(
            template[head] - (joints[name("right_eye_smplhf")] + [-0.046, -0.02, -0.079]), axis=1))]],
    }  # fmt: skip
    middle = head[np.abs(template[head, 0]) < 0.004]
    points = {"nose": template[middle[np.argmax(template[middle, 2])]] * [0, 1, 1]}
    for part, place in right.items():
        points |= {f"right_{part}": place, f"left_{part}": place * MIRROR}
    return points


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--body", type=Path, default=BODY)
    options = parser.parse_args()
    model = load_model(options.body)
    points = face_points(model) | body_points(model)
    right = {name: place for name, place in points.items() if not name.startswith("left_")}
    closest = SurfaceTree(model.template, model.faces).closest(np.array(list(right.values())))
    rows = {}
    for name, face, weights in zip(right, closest.faces, closest.barycentric, strict=True):
        corners = model.faces[face]
        rows[name] = [*corners.tolist(), *weights.round(6).tolist()]
        if other_side(name) != name:
            rows[other_side(name)] = [*model.mirror_vertices[corners].tolist(), *weights.round(6).tolist()]
    with OUT.open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([name, *row] for name, row in sorted(rows.items()))
    print(f"{OUT}: {len(rows)} points")


if __name__ == "__main__":
    main()
