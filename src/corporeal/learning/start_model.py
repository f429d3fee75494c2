"""Models to start learning from: a user's own template with its joints, or a model whose rig is forgotten."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int

from corporeal.geometry.topology import connected_components
from corporeal.learning.rigging import bone_weights, ring_regressor, strongest_joints
from corporeal.model.statistics import PoseBlock
from corporeal.model.surface_model import SurfaceModel

# Rows of weights may miss the sum of one by rounding in a file, by no more.
_SUM_TOLERANCE = 1e-3
# Metres across; a template beyond this is in millimetres.
_LARGEST_SIZE = 50.0
_RIG_NOTE = "weights by distance to bones, joints from rings of vertices, shape space by uniform scaling"


def start_model(
    template: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    joints: Float[np.ndarray, "K 3"],
    parents: Sequence[int],
    joint_names: Sequence[str],
    *,
    name: str,
    weights: Float[np.ndarray, "_ _"] | None = None,
    size_deviation: float = 0.07,
) -> SurfaceModel:
    """A model of any kinematic tree with a crude rig: enough to register with and to learn from.

    Its shape space is uniform scaling about the root, its pose block "pose" holds all joints and knows
    nothing, and it has no correctives. A hand's side, parts or landmarks are added with
    ``SurfaceModel.replace``.

    Args:
        template: the surface at the zero pose, metres; connected, every vertex in a face.
        faces: triangles, counter-clockwise seen from outside.
        joints: their places inside the template, metres.
        parents: K numbers; the root comes first with -1, parents before their children.
        joint_names: K names, all different.
        name: of the model.
        weights: (V, K) rough skinning weights, non-negative, rows summing to one; the four strongest joints
            of a vertex are kept. None: by distance to bones (``rigging.bone_weights``).
        size_deviation: standard deviation of people's sizes as a share of the size.

    Raises:
        ValueError: an argument that does not fit; the message names it and says what was expected.
    """
    tree = np.asarray(parents, dtype=np.int64)
    template, joints = template.astype(np.float64), joints.astype(np.float64)
    _check_mesh(template, faces)
    _check_tree(joints, tree, joint_names)
    if not 0 < size_deviation < 1:
        raise ValueError(f"size_deviation: expected a share between 0 and 1, got {size_deviation}")
    count = len(joint_names)
    skinning, regressor = _rig(template, faces, joints, tree, joint_names, weights)
    blocks = (PoseBlock.plain("pose", tuple(range(1, count))),) if count > 1 else ()
    return SurfaceModel(
        name=name,
        template=template,
        faces=faces.astype(np.int64),
        shape_directions=_scaling(template, joints[0], size_deviation),
        joint_regressor=regressor,
        skinning_weights=skinning,
        parents=tree,
        joint_names=tuple(joint_names),
        expression_directions=np.zeros((len(template), 3, 0)),
        pose_directions=np.zeros((len(template), 3, 0)),
        pose_blocks=blocks,
        notes={
            "rig": _RIG_NOTE if weights is None else _RIG_NOTE.replace("by distance to bones", "as given")
        },
    )


def crude_start(model: SurfaceModel, size_deviation: float = 0.07) -> SurfaceModel:
    """The model with its rig forgotten: what one has who knows a template and its joints, and nothing else.

    Weights, joint regressor and shape space are made as in ``start_model``; there are no correctives and no
    expressions. Template, topology, tree, landmarks, cut, parts, side and the pose statistics with their
    limits are kept: the statistics come from recorded poses, not from the rig, and a registration without
    them would be another comparison.

    Raises:
        ValueError: a template in pieces, or a joint that lies outside of it.
    """
    template = model.template.astype(np.float64)
    joints = np.asarray(model.joint_regressor @ template)
    _check_mesh(template, model.faces)
    weights, regressor = _rig(template, model.faces, joints, model.parents, model.joint_names, None)
    return model.replace(
        name=f"{model.name}_crude",
        template=template,
        skinning_weights=weights,
        joint_regressor=regressor,
        shape_directions=_scaling(template, joints[0], size_deviation),
        expression_directions=np.zeros((len(template), 3, 0)),
        pose_directions=np.zeros((len(template), 3, 0)),
        notes={**model.notes, "rig": _RIG_NOTE, "correctives": "none"},
    )


def _rig(
    template: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], joints: Float[np.ndarray, "K 3"],
    parents: Int[np.ndarray, " K"], joint_names: Sequence[str], given: Float[np.ndarray, "_ _"] | None,
) -> tuple[Float[np.ndarray, "V K"], sp.csr_matrix]:  # fmt: skip
    """Skinning weights and joint regressor."""
    if given is None:
        weights = bone_weights(template, faces, joints, parents, joint_names)
    else:
        weights = _checked_weights(given, (len(template), len(joints)))
    return weights, ring_regressor(template, joints, parents, weights, joint_names)


def _scaling(
    template: Float[np.ndarray, "V 3"], root: Float[np.ndarray, "3"], deviation: float
) -> Float[np.ndarray, "V 3 1"]:
    return deviation * (template - root)[:, :, None]


def _check_mesh(template: np.ndarray, faces: np.ndarray) -> None:
    if template.ndim != 2 or template.shape[1] != 3 or not np.isfinite(template).all():
        raise ValueError(f"template: expected (V, 3) finite numbers, got {template.shape}")
    size = float(np.ptp(template, axis=0).max(initial=0))
    if not 0 < size <= _LARGEST_SIZE:
        raise ValueError(f"template: {size:.3g} m across; expected metres, at most {_LARGEST_SIZE:g}")
    if faces.ndim != 2 or faces.shape[1] != 3 or not np.issubdtype(faces.dtype, np.integer):
        raise ValueError(f"faces: expected (F, 3) vertex indices, got {faces.shape} of {faces.dtype}")
    if not len(faces) or faces.min() < 0 or faces.max() >= len(template):
        raise ValueError(f"faces: expected vertex indices 0..{len(template) - 1}")
    loose = int(np.count_nonzero(connected_components(faces, len(template))))
    if loose:
        raise ValueError(
            f"faces: {loose} of {len(template)} vertices do not hang together with the rest; weights spread "
            "along the surface, so give one connected mesh (weld it, drop loose vertices)"
        )


def _check_tree(joints: np.ndarray, parents: np.ndarray, joint_names: Sequence[str]) -> None:
    count = len(joint_names)
    if joints.shape != (count, 3) or not np.isfinite(joints).all():
        raise ValueError(
            f"joints: expected ({count}, 3) finite numbers for {count} names, got {joints.shape}"
        )
    if parents.shape != (count,):
        raise ValueError(f"parents: expected {count} numbers for {count} joint names, got {parents.shape}")
    if parents[0] != -1 or (parents[1:] < 0).any() or (parents[1:] >= np.arange(1, count)).any():
        raise ValueError("parents: expected the root first with parent -1, and parents before their children")
    if len(set(joint_names)) != count:
        raise ValueError(f"joint_names: expected {count} different names")


def _checked_weights(weights: np.ndarray, shape: tuple[int, int]) -> Float[np.ndarray, "V K"]:
    if weights.shape != shape:
        raise ValueError(f"weights: expected {shape} for vertices and joints, got {weights.shape}")
    if not np.isfinite(weights).all() or (weights < 0).any():
        raise ValueError("weights: expected finite numbers of at least 0")
    miss = np.abs(weights.sum(axis=1) - 1)
    if miss.max() > _SUM_TOLERANCE:
        worst = int(miss.argmax())
        raise ValueError(
            f"weights: expected rows that sum to 1; vertex {worst} has {weights[worst].sum():.4g}"
        )
    return strongest_joints(weights.astype(np.float64))
