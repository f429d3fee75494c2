"""Mirroring models and poses at the plane x = 0 (section 1 of the supplement of Romero et al. 2017).

A single hand becomes the other hand: its vertices and joints keep their indices. A whole body that knows its
own symmetry (``mirror_vertices``, ``mirror_joints``) is also renumbered: index for index, left stays left.
In both cases ``mirror_model(m)(mirror_pose(p, m))`` is the mirror image of ``m(p)``.
"""

from __future__ import annotations

import re
from typing import overload

import numpy as np
import scipy.sparse as sp
import torch
from jaxtyping import Float, Int
from torch import Tensor

from corporeal.model.landmarks import LandmarkSet
from corporeal.model.pose import CoefficientPose, FullPose, Pose
from corporeal.model.statistics import PoseBlock, PoseMixture
from corporeal.model.surface_model import CutPlane, Side, SurfaceModel

# The diagonal of M (equation 1), and what M R M does to the numbers of each representation.
_DIAGONAL = (-1.0, 1.0, 1.0)
_AXIS_ANGLE_SIGNS = (1.0, -1.0, -1.0)
_MATRIX_SIGNS = ((1.0, -1.0, -1.0), (-1.0, 1.0, 1.0), (-1.0, 1.0, 1.0))
_POSE_SIGNS = {
    "axis_angle": _AXIS_ANGLE_SIGNS,
    "matrix": _MATRIX_SIGNS,
    "quaternion": (1.0, 1.0, -1.0, -1.0),
    "6d": (1.0, -1.0, -1.0, -1.0, 1.0, 1.0),
}
_OTHER_SIDE = {"left": "right", "right": "left", "l": "r", "r": "l"}
_SIDE_WORD = re.compile(r"left|right|(?<![a-z])[lr](?![a-z])", re.IGNORECASE)


def mirror_model(model: SurfaceModel) -> SurfaceModel:
    """The mirror image of a model; mirroring twice gives the first model back, bit for bit.

    Template, shape and expression directions are multiplied by M, pose directions by M and un-mirrored per
    3x3 input block (equations 3, 5 and 6); joint regressor and weights stay. Faces change their winding,
    ``side`` and the words left and right in every name are swapped.

    Raises:
        ValueError: a whole body with only one of ``mirror_vertices`` and ``mirror_joints``, or with maps that
            are not their own inverse or move the root.
    """
    vertex_map, joint_map = _index_maps(model)
    diagonal = np.array(_DIAGONAL)
    signs = {"v": diagonal.astype(model.template.dtype)[:, None]}
    faces = model.faces if vertex_map is None else vertex_map[model.faces].astype(model.faces.dtype)
    return model.replace(
        name=swap_sides(model.name),
        template=_rows(model.template, vertex_map) * signs["v"][:, 0],
        faces=np.ascontiguousarray(faces[:, [0, 2, 1]]),
        shape_directions=_rows(model.shape_directions, vertex_map) * signs["v"],
        expression_directions=_rows(model.expression_directions, vertex_map) * signs["v"],
        pose_directions=_mirrored_pose_directions(model.pose_directions, vertex_map, joint_map),
        joint_regressor=_permuted(model.joint_regressor, joint_map, vertex_map),
        skinning_weights=_columns(_rows(model.skinning_weights, vertex_map), joint_map),
        parents=_mirrored_parents(model.parents, joint_map),
        joint_names=_mirrored_names(model.joint_names, joint_map),
        side=_swapped_side(model.side),
        parts={swap_sides(name): _mapped(part, vertex_map) for name, part in model.parts.items()},
        pose_blocks=_mirrored_blocks(model),
        landmarks=_mirrored_landmarks(model, vertex_map, joint_map),
        cut=_mirrored_cut(model.cut, joint_map),
    )


def mirror_pose(pose: Pose, model: SurfaceModel | None = None) -> Pose:
    """The mirrored pose: R becomes M R M, in the representation in which it was given.

    Coefficients stay as they are, because the components of the mirrored model are mirrored; blocks named
    left and right are swapped.

    Args:
        pose: a pose of ``model``.
        model: needed for a whole body that is its own mirror image, whose left and right joints are swapped;
            without it every joint keeps its index.

    Returns:
        A pose for ``mirror_model(model)``. A full pose also fits a body that is its own mirror image.
    """
    joint_map = None if model is None else _index_maps(model)[1]
    if isinstance(pose, FullPose):
        values = pose.values if joint_map is None else pose.values[:, torch.as_tensor(joint_map)]
        return FullPose(values * _signs_like(_POSE_SIGNS[pose.representation], values), pose.representation)
    flip = _signs_like(_AXIS_ANGLE_SIGNS, pose.root)
    rotations = {}
    for name, rotation in pose.rotations.items():
        order = slice(None) if model is None else _block_order(model, model.block(name))[1]
        rotations[swap_sides(name)] = rotation[:, order] * flip
    coefficients = {swap_sides(name): numbers for name, numbers in pose.coefficients.items()}
    return CoefficientPose(pose.root * flip, coefficients, rotations)


@overload
def mirror_translation(translation: Tensor) -> Tensor: ...
@overload
def mirror_translation(translation: np.ndarray) -> np.ndarray: ...
def mirror_translation(
    translation: Float[Tensor, "*b 3"] | Float[np.ndarray, "*b 3"],
) -> Float[Tensor, "*b 3"] | Float[np.ndarray, "*b 3"]:
    """Points or translations in metres with x negated; tensor in, tensor out, array in, array out."""
    if isinstance(translation, Tensor):
        return translation * _signs_like(_DIAGONAL, translation)
    return translation * np.array(_DIAGONAL, dtype=translation.dtype)


def swap_sides(name: str) -> str:
    """A name with left and right exchanged, also as lone letters: "left_wrist", "hand.R" -> "hand.L"."""

    def other(match: re.Match[str]) -> str:
        word = match.group()
        swapped = _OTHER_SIDE[word.lower()]
        if word.isupper():
            return swapped.upper()
        return swapped.capitalize() if word[0].isupper() else swapped

    return _SIDE_WORD.sub(other, name)


def _index_maps(
    model: SurfaceModel,
) -> tuple[Int[np.ndarray, " V"] | None, Int[np.ndarray, " K"] | None]:
    """The symmetry of a whole body, or two None where indices stay."""
    vertex_map, joint_map = model.mirror_vertices, model.mirror_joints
    if model.side is not None or (vertex_map is None and joint_map is None):
        return None, None
    if vertex_map is None or joint_map is None:
        raise ValueError("model: a whole body needs both mirror_vertices and mirror_joints to be mirrored")
    for label, index_map in (("mirror_vertices", vertex_map), ("mirror_joints", joint_map)):
        if not np.array_equal(index_map[index_map], np.arange(len(index_map))):
            raise ValueError(f"{label}: mirroring twice must lead back to every index")
    if joint_map[0] != 0:
        raise ValueError(f"mirror_joints: the root must be its own mirror image, not joint {joint_map[0]}")
    return vertex_map, joint_map


def _signs_like(signs: tuple, values: Tensor) -> Tensor:
    return torch.tensor(signs, dtype=values.dtype, device=values.device)


def _rows(array: np.ndarray, index_map: np.ndarray | None) -> np.ndarray:
    return array if index_map is None else array[index_map]


def _columns(array: np.ndarray, index_map: np.ndarray | None) -> np.ndarray:
    return array if index_map is None else np.ascontiguousarray(array[:, index_map])


def _mapped(indices: np.ndarray, index_map: np.ndarray | None) -> np.ndarray:
    return indices if index_map is None else index_map[indices].astype(indices.dtype)


def _permuted(
    matrix: sp.csr_matrix, row_map: np.ndarray | None, column_map: np.ndarray | None
) -> sp.csr_matrix:
    if row_map is None or column_map is None:
        return matrix
    return matrix[row_map][:, column_map].tocsr()


def _mirrored_names(names: tuple[str, ...], index_map: np.ndarray | None) -> tuple[str, ...]:
    order = range(len(names)) if index_map is None else index_map
    return tuple(swap_sides(names[index]) for index in order)


def _mirrored_parents(parents: np.ndarray, joint_map: np.ndarray | None) -> np.ndarray:
    if joint_map is None:
        return parents
    moved = parents[joint_map]
    return np.where(moved < 0, -1, joint_map[moved]).astype(parents.dtype)


def _mirrored_pose_directions(
    directions: Float[np.ndarray, "V 3 P"], vertex_map: np.ndarray | None, joint_map: np.ndarray | None
) -> Float[np.ndarray, "V 3 P"]:
    V, _, P = directions.shape
    if P == 0:
        return _rows(directions, vertex_map)
    per_joint = _rows(directions, vertex_map).reshape(V, 3, P // 9, 3, 3)
    if joint_map is not None:
        per_joint = per_joint[:, :, joint_map[1:] - 1]
    signs = np.array(_DIAGONAL)[:, None, None, None] * np.array(_MATRIX_SIGNS)
    return (per_joint * signs.astype(directions.dtype)).reshape(V, 3, P)


def _block_order(model: SurfaceModel, block: PoseBlock) -> tuple[tuple[int, ...], Int[np.ndarray, " n"]]:
    """Joints of the mirrored block, and the order in which it takes those of ``block``.

    Where the mirrored joints are those of the block that the model already has under the swapped name, they
    come in that block's order: the pose of a body then also fits the same body.
    """
    joint_map = _index_maps(model)[1]
    moved = block.joints if joint_map is None else tuple(int(joint_map[joint]) for joint in block.joints)
    name = swap_sides(block.name)
    for counterpart in model.pose_blocks:
        if joint_map is not None and counterpart.name == name and set(counterpart.joints) == set(moved):
            return counterpart.joints, np.array(
                [moved.index(joint) for joint in counterpart.joints], dtype=int
            )
    return moved, np.arange(len(moved))


def _mirrored_blocks(model: SurfaceModel) -> tuple[PoseBlock, ...]:
    blocks = [_mirrored_block(model, block) for block in model.pose_blocks]
    names = [block.name for block in model.pose_blocks]
    if {block.name for block in blocks} == set(names):
        blocks.sort(key=lambda block: names.index(block.name))
    return tuple(blocks)


def _mirrored_block(model: SurfaceModel, block: PoseBlock) -> PoseBlock:
    joints, order = _block_order(model, block)
    numbers = (3 * order[:, None] + np.arange(3)).ravel()
    signs = np.tile(_AXIS_ANGLE_SIGNS, len(joints)).astype(block.mean.dtype)
    mixture, limits = block.mixture, block.limits
    if mixture is not None:
        covariances = mixture.covariances[:, numbers][:, :, numbers] * np.outer(signs, signs)
        mixture = PoseMixture(mixture.weights, mixture.means[:, numbers] * signs, covariances)
    if limits is not None:
        signed = limits[numbers] * signs[:, None]
        limits = np.where(signs[:, None] < 0, signed[:, ::-1], signed)
    return PoseBlock(
        name=swap_sides(block.name),
        joints=joints,
        mean=block.mean[numbers] * signs,
        components=block.components[:, numbers] * signs,
        component_deviations=block.component_deviations,
        mean_included=block.mean_included,
        mixture=mixture,
        limits=limits,
    )


def _mirrored_landmarks(
    model: SurfaceModel, vertex_map: np.ndarray | None, joint_map: np.ndarray | None
) -> dict[str, LandmarkSet]:
    mirrored = {}
    for set_name, landmarks in model.landmarks.items():
        weights = landmarks.weights
        if vertex_map is not None and joint_map is not None:
            weights = weights[:, np.concatenate([vertex_map, joint_map + model.vertex_count])].tocsr()
        names = tuple(swap_sides(name) for name in landmarks.names)
        moved = LandmarkSet(names, weights, landmarks.vertex_count)
        # A set that holds both sides keeps its published order; its rows change places instead.
        if set(names) == set(landmarks.names):
            moved = moved.reordered(landmarks.names)
        mirrored[swap_sides(set_name)] = moved
    return mirrored


def _mirrored_cut(cut: CutPlane | None, joint_map: np.ndarray | None) -> CutPlane | None:
    if cut is None:
        return None
    joint = cut.joint if joint_map is None else int(joint_map[cut.joint])
    diagonal = np.array(_DIAGONAL)
    return CutPlane(joint, cut.point * diagonal, cut.normal * diagonal)


def _swapped_side(side: Side | None) -> Side | None:
    if side is None:
        return None
    return "left" if side == "right" else "right"
