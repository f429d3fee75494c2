"""The head of a body as a model of its own: for scans that end at the neck or the shoulders."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import scipy.sparse as sp

from corporeal.geometry.topology import boundary_loops
from corporeal.model.landmarks import LandmarkSet
from corporeal.model.parts import select_part
from corporeal.model.surface_model import CutPlane, SurfaceModel

HEAD_PARTS = ("head", "neck", "left_eye", "right_eye")
_JOINTS = ("neck", "head", "jaw", "left_eye_smplhf", "right_eye_smplhf")
DETECTED = "face_51_detector"
_LANDMARKS = (DETECTED, "face_68_ibug", "face")
# Metres above the edge of the neck's skin: below, a scan goes on where the model has ended.
_ABOVE = 4e-3


def with_face_marks(body: SurfaceModel, file: Path) -> SurfaceModel:
    """The body with the landmark set "face_51_detector": where the detector of faces sees them on it.

    Args:
        body: the open body.
        file: what ``assets/calibrate_face_detector.py`` wrote for it.

    Raises:
        ValueError: the file is of another body.
    """
    with np.load(file, allow_pickle=False) as stored:
        if int(stored["vertex_count"]) != body.vertex_count:
            raise ValueError(f"{file.name}: made for {stored['vertex_count']} vertices; calibrate it anew")
        shape = (len(stored["names"]), body.vertex_count + body.joint_count)
        weights = sp.csr_matrix((stored["weights"], stored["vertices"], stored["starts"]), shape=shape)
        marks = LandmarkSet(tuple(stored["names"].tolist()), weights, body.vertex_count)
    return body.replace(landmarks={**body.landmarks, DETECTED: marks})


def head_of(body: SurfaceModel, *, expressions: int = 40) -> SurfaceModel:
    """Head, neck and eyes of the open body, from the neck's joint up.

    Its shape numbers are the body's, then the first expressions: who a face is and what it does are told
    apart by neither a scan nor the fit, which solves for all of them. What a scan has below the neck is cut
    off by a plane, as the arm of a hand is.

    Args:
        body: a model with the open body's parts and joints.
        expressions: how many of its expression directions become shape directions.

    Raises:
        KeyError: a part or joint that the body does not have.
        ValueError: the neck of the part has another edge than one loop.
    """
    part = select_part(body, HEAD_PARTS, _JOINTS, name="head")
    loops = boundary_loops(part.faces)
    if len(loops) != 1:
        raise ValueError(f"body: expected a neck that ends in one loop, found {len(loops)}")
    edge = part.template[loops[0]].astype(np.float64)
    normal = np.linalg.svd(edge - edge.mean(0))[2][2]
    normal *= np.sign((part.template.mean(0) - edge.mean(0)) @ normal)
    root = np.asarray(part.joint_regressor @ part.template)[0]
    expressed = part.expression_directions[:, :, :expressions]
    return part.replace(
        shape_directions=np.concatenate([part.shape_directions, expressed], axis=2),
        expression_directions=part.expression_directions[:, :, :0],
        landmarks={name: part.landmarks[name] for name in _LANDMARKS if name in part.landmarks},
        cut=CutPlane(0, edge.mean(0) + _ABOVE * normal - root, normal),
    )
