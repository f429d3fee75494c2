"""Keypoint sets of the body: joints, points of the surface, and the open hand's own 21 on both sides."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import scipy.sparse as sp

from corporeal.model.landmarks import LandmarkSet
from corporeal.model.surface_model import SurfaceModel

from .face_names import FACE_68
from .rig import JOINT_NAMES, RIGHT_HAND, mirror_joints

# Corners and weights of points on the triangles of this mesh; written by ../mark_body.py.
SURFACE_POINTS = Path(__file__).with_name("surface_points.csv")
_LIMBS = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
_HEAD = ("nose", "left_eye", "right_eye", "left_ear", "right_ear")
_FEET = tuple(f"{side}_{part}" for side in ("left", "right") for part in ("big_toe", "small_toe", "heel"))
_COCO_17 = (*_HEAD, *(f"{side}_{limb}" for limb in _LIMBS for side in ("left", "right")))
_BODY_25 = (
    "nose", "neck", *(f"{side}_{limb}" for side in ("right", "left") for limb in _LIMBS[:3]), "mid_hip",
    *(f"{side}_{limb}" for side in ("right", "left") for limb in _LIMBS[3:]), "right_eye", "left_eye",
    "right_ear", "left_ear", *_FEET,
)  # fmt: skip
_MEDIAPIPE_33 = (
    "nose", "left_eye_inner", "left_eye", "left_eye_outer", "right_eye_inner", "right_eye", "right_eye_outer",
    "left_ear", "right_ear", "left_mouth_corner", "right_mouth_corner",
    *(f"{side}_{part}" for part in (*_LIMBS[:3], "pinky", "index", "thumb", *_LIMBS[3:], "heel", "big_toe")
      for side in ("left", "right")),
)  # fmt: skip
# The extra joints of smplx, which are single vertices, in its order.
_SMPLX_VERTICES = (
    "nose", "right_eye_front", "left_eye_front", "right_ear", "left_ear", *_FEET,
    *(f"{side}_hand_{finger}_tip" for side in ("left", "right")
      for finger in ("thumb", "index", "middle", "ring", "little")),
)  # fmt: skip

Row = dict[int, float]


def landmark_sets(
    hand: SurfaceModel, hand_vertices: np.ndarray, mirror: np.ndarray
) -> dict[str, LandmarkSet]:
    """All sets by name."""
    V = len(mirror)
    points = {f"{side}_hand_{name}": row for side, rows in _hand_rows(hand, hand_vertices, mirror,
              "hand_21_mediapipe").items() for name, row in rows.items()}  # fmt: skip
    points |= _surface_points() | _joint_points(V)
    names_21 = hand.landmarks["hand_21_mediapipe"].names
    hands = {side: tuple(f"{side}_hand_{name}" for name in names_21) for side in ("left", "right")}
    sets = {
        "coco_17": _COCO_17,
        "body_25": _BODY_25,
        "mediapipe_33": _MEDIAPIPE_33,
        "left_hand_21_mediapipe": hands["left"],
        "right_hand_21_mediapipe": hands["right"],
        "face_68_ibug": FACE_68,
        "face": FACE_68[17:],
        "coco_wholebody_133": (*_COCO_17, *_FEET, *FACE_68, *hands["left"], *hands["right"]),
    }
    made = {name: _landmark_set(names, [points[n] for n in names], V) for name, names in sets.items()}
    for side, rows in _hand_rows(hand, hand_vertices, mirror, "hand_21_detector").items():
        names = tuple(f"{side}_hand_{name}" for name in rows)
        made[f"{side}_hand_21_detector"] = _landmark_set(names, list(rows.values()), V)
    nearest = [{max(points[n], key=points[n].__getitem__): 1.0} for n in _SMPLX_VERTICES]
    return made | {"smplx_vertices": _landmark_set(_SMPLX_VERTICES, nearest, V)}


def _surface_points() -> dict[str, Row]:
    with SURFACE_POINTS.open(newline="") as file:
        return {
            name: _summed(zip(map(int, numbers[:3]), map(float, numbers[3:]), strict=True))
            for name, *numbers in csv.reader(file)
        }


def _summed(entries: object) -> Row:
    row: Row = {}
    for column, weight in entries:
        row[column] = row.get(column, 0.0) + weight
    total = sum(row.values())
    return {column: weight / total for column, weight in row.items()}


def _joint_points(vertex_count: int) -> dict[str, Row]:
    joint = {name: vertex_count + j for j, name in enumerate(JOINT_NAMES)}
    points = {name: {joint[name]: 1.0} for name in JOINT_NAMES[:22]}
    points["mid_hip"] = {joint["left_hip"]: 0.5, joint["right_hip"]: 0.5}
    # OpenPose's and COCO's neck is the middle of the shoulders.
    points["neck"] = {joint["left_shoulder"]: 0.5, joint["right_shoulder"]: 0.5}
    for side in ("left", "right"):
        points[f"{side}_eye"] = {joint[f"{side}_eye_smplhf"]: 1.0}
        for name, finger in (("pinky", "little1"), ("index", "index1"), ("thumb", "thumb2")):
            points[f"{side}_{name}"] = {joint[f"{side}_{finger}"]: 1.0}
    return points


def _hand_rows(
    hand: SurfaceModel, hand_vertices: np.ndarray, mirror: np.ndarray, set_name: str
) -> dict[str, dict[str, Row]]:
    V = len(mirror)
    columns = np.concatenate([hand_vertices, V + np.array(RIGHT_HAND)])
    over = np.concatenate([mirror, V + mirror_joints()])
    landmarks = hand.landmarks[set_name]
    right = {
        name: {int(columns[c]): float(w) for c, w in zip(row.indices, row.data, strict=True)}
        for name, row in zip(landmarks.names, landmarks.weights, strict=True)
    }
    left = {name: {int(over[c]): w for c, w in row.items()} for name, row in right.items()}
    return {"left": left, "right": right}


def _landmark_set(names: Sequence[str], rows: Sequence[Row], vertex_count: int) -> LandmarkSet:
    entries = [(r, c, w) for r, row in enumerate(rows) for c, w in row.items()]
    index, columns, values = zip(*entries, strict=True)
    weights = sp.csr_matrix((values, (index, columns)), shape=(len(names), vertex_count + len(JOINT_NAMES)))
    return LandmarkSet(tuple(names), weights, vertex_count)
