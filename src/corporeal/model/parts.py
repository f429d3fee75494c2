"""Cutting a part out of a model: the hand of a body, the head of a body."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int

from corporeal.model.landmarks import LandmarkSet
from corporeal.model.statistics import PoseBlock, PoseMixture
from corporeal.model.surface_model import CutPlane, Side, SurfaceModel

# Rest joints of a part may move by this much (metres per unit of a coefficient), no more.
_JOINT_TOLERANCE = 1e-5


def select_part(
    model: SurfaceModel, vertices: Int[np.ndarray, " n"] | Sequence[str],
    joints: Sequence[int] | Sequence[str], *, name: str, side: Side | None = None,
) -> SurfaceModel:  # fmt: skip
    """The model of a part: its vertices, the faces between them, and its joints.

    Posed alike, the part equals the same vertices of the whole as long as the dropped joints do not move and,
    for vertices that hung on joints above the part, its root does not turn:

    - weights of a dropped joint go to its nearest kept ancestor, or to the part's root where there is none;
    - the root loses its own pose correctives (a root has none);
    - a regressor row whose vertices are all kept stays; any other is solved anew, as the smallest row over
      the kept vertices that gives the same rest joint for the template and for every shape and expression;
    - landmarks that lose a vertex or joint are dropped, and so are parts and landmark sets that become empty;
    - pose blocks keep the numbers of their kept joints; coefficients still mean the same rotations;
    - the cut plane stays if its joint does; symmetry maps stay if the part is its own mirror image.

    Args:
        model: the whole.
        vertices: indices of the kept vertices, or names of parts whose union is kept.
        joints: kept joints by index or name; one of them is the ancestor of all others and becomes the root.
        name: the name of the part.
        side: "left" or "right" for a hand.

    Raises:
        KeyError: a part or joint that the model does not have.
        ValueError: nothing kept, more than one root, or a joint that the kept vertices cannot give.
    """
    kept = _kept_vertices(model, vertices)
    bones = _kept_joints(model, joints)
    heirs = _heirs(model.parents, bones)
    new_vertex = _inverse(kept, model.vertex_count)
    faces = new_vertex[model.faces]
    maps = _symmetry(model, kept, bones)
    return model.replace(
        name=name,
        template=model.template[kept],
        faces=faces[(faces >= 0).all(axis=1)].astype(model.faces.dtype),
        shape_directions=model.shape_directions[kept],
        expression_directions=model.expression_directions[kept],
        pose_directions=_cut_pose_directions(model, kept, bones),
        joint_regressor=_cut_regressor(model, kept, bones),
        skinning_weights=_merged_weights(model.skinning_weights[kept], heirs, len(bones)),
        parents=np.array(
            [-1, *(heirs[model.parents[bone]] for bone in bones[1:])], dtype=model.parents.dtype
        ),
        joint_names=tuple(model.joint_names[bone] for bone in bones),
        side=side,
        parts=_cut_parts(model, new_vertex),
        pose_blocks=_cut_blocks(model, bones),
        landmarks=_cut_landmarks(model, kept, bones),
        mirror_vertices=maps[0],
        mirror_joints=maps[1],
        cut=_cut_plane(model, bones),
    )


def _kept_vertices(model: SurfaceModel, vertices: Int[np.ndarray, " n"] | Sequence[str]) -> np.ndarray:
    if isinstance(vertices, np.ndarray):
        kept = np.unique(vertices)
    else:
        for part in vertices:
            if part not in model.parts:
                raise KeyError(f"part {part!r} is not among {', '.join(model.parts)}")
        kept = np.unique(np.concatenate([model.parts[part] for part in vertices] or [np.zeros(0, int)]))
    if not len(kept) or kept[0] < 0 or kept[-1] >= model.vertex_count:
        raise ValueError(f"vertices: expected some of 0..{model.vertex_count - 1}")
    return kept


def _kept_joints(model: SurfaceModel, joints: Sequence[int] | Sequence[str]) -> tuple[int, ...]:
    indices = set()
    for joint in joints:
        if joint not in model.joint_names and joint not in range(model.joint_count):
            raise KeyError(f"joint {joint!r} is not among {', '.join(model.joint_names)}")
        indices.add(model.joint_names.index(joint) if isinstance(joint, str) else int(joint))
    bones = tuple(sorted(indices))
    roots = [bone for bone in bones if not indices & set(_ancestors(model.parents, bone))]
    if len(roots) != 1:
        names = ", ".join(model.joint_names[root] for root in roots) or "none"
        raise ValueError(f"joints: a part needs exactly one joint above all others, got {names}")
    return bones


def _ancestors(parents: np.ndarray, joint: int) -> list[int]:
    """From the parent up to the root."""
    above = []
    while parents[joint] >= 0:
        joint = int(parents[joint])
        above.append(joint)
    return above


def _heirs(parents: np.ndarray, bones: tuple[int, ...]) -> Int[np.ndarray, " K"]:
    """For every joint of the whole the joint of the part that carries its weights."""
    place = {bone: index for index, bone in enumerate(bones)}
    lines = ([joint, *_ancestors(parents, joint)] for joint in range(len(parents)))
    return np.array([next((place[joint] for joint in line if joint in place), 0) for line in lines])


def _inverse(kept: np.ndarray, count: int) -> Int[np.ndarray, " n"]:
    """New index of every old one; -1 for those that are dropped."""
    new = np.full(count, -1)
    new[kept] = np.arange(len(kept))
    return new


def _merged_weights(weights: Float[np.ndarray, "n K"], heirs: np.ndarray, count: int) -> np.ndarray:
    merged = np.zeros((len(weights), count), dtype=weights.dtype)
    np.add.at(merged.T, heirs, weights.T)
    return merged


def _cut_pose_directions(model: SurfaceModel, kept: np.ndarray, bones: tuple[int, ...]) -> np.ndarray:
    directions = model.pose_directions[kept]
    if not model.has_correctives:
        return directions
    columns = [9 * (bone - 1) + element for bone in bones[1:] for element in range(9)]
    return directions[:, :, columns]


def _cut_regressor(model: SurfaceModel, kept: np.ndarray, bones: tuple[int, ...]) -> sp.csr_matrix:
    rows = model.joint_regressor[list(bones)]
    lost = np.setdiff1d(np.arange(model.vertex_count), kept)
    damaged = np.flatnonzero(abs(rows[:, lost]).sum(axis=1))
    cut = rows[:, kept].tolil()
    if len(damaged):
        solved = _solved_rows(model, kept, [bones[row] for row in damaged])
        cut[damaged] = solved
    return cut.tocsr()


def _solved_rows(model: SurfaceModel, kept: np.ndarray, bones: list[int]) -> Float[np.ndarray, "n V"]:
    """Smallest rows over the kept vertices with sum 1 that give the same joints for every coefficient."""
    fields = [model.template[:, :, None], model.shape_directions, model.expression_directions]
    content = np.concatenate(fields, axis=2, dtype=np.float64)
    wanted = np.asarray(model.joint_regressor[bones] @ content.reshape(model.vertex_count, -1))
    equations = np.concatenate([content[kept].reshape(len(kept), -1), np.ones((len(kept), 1))], axis=1)
    targets = np.concatenate([wanted, np.ones((len(bones), 1))], axis=1)
    solved = np.linalg.lstsq(equations.T, targets.T, rcond=None)[0].T
    # The sum must hold to the last bit even where the positions are met only nearly.
    solved /= solved.sum(axis=1, keepdims=True)
    error = np.abs(solved @ equations - targets).max(axis=1)
    if error.max() > _JOINT_TOLERANCE:
        worst = bones[int(error.argmax())]
        raise ValueError(
            f"joints: the kept vertices cannot give the rest position of {model.joint_names[worst]!r} "
            f"(error {1000 * error.max():.3g} mm): keep the vertices around it"
        )
    return solved


def _cut_parts(model: SurfaceModel, new_vertex: np.ndarray) -> dict[str, np.ndarray]:
    moved = {name: new_vertex[part] for name, part in model.parts.items()}
    return {name: part[part >= 0] for name, part in moved.items() if (part >= 0).any()}


def _cut_blocks(model: SurfaceModel, bones: tuple[int, ...]) -> tuple[PoseBlock, ...]:
    blocks = []
    for block in model.pose_blocks:
        places = [place for place, joint in enumerate(block.joints) if joint in bones[1:]]
        if not places:
            continue
        numbers = np.array([3 * place + axis for place in places for axis in range(3)])
        mixture = block.mixture
        if mixture is not None:
            covariances = mixture.covariances[:, numbers][:, :, numbers]
            mixture = PoseMixture(mixture.weights, mixture.means[:, numbers], covariances)
        blocks.append(
            PoseBlock(
                name=block.name,
                joints=tuple(bones.index(block.joints[place]) for place in places),
                mean=block.mean[numbers],
                components=block.components[:, numbers],
                component_deviations=block.component_deviations,
                mean_included=block.mean_included,
                mixture=mixture,
                limits=None if block.limits is None else block.limits[numbers],
            )
        )
    return tuple(blocks)


def _cut_landmarks(model: SurfaceModel, kept: np.ndarray, bones: tuple[int, ...]) -> dict[str, LandmarkSet]:
    columns = np.concatenate([kept, model.vertex_count + np.array(bones)])
    lost = np.setdiff1d(np.arange(model.vertex_count + model.joint_count), columns)
    cut = {}
    for set_name, landmarks in model.landmarks.items():
        whole = np.flatnonzero(abs(landmarks.weights[:, lost]).sum(axis=1) == 0)
        if len(whole):
            names = tuple(landmarks.names[row] for row in whole)
            cut[set_name] = LandmarkSet(names, landmarks.weights[whole][:, columns].tocsr(), len(kept))
    return cut


def _symmetry(
    model: SurfaceModel, kept: np.ndarray, bones: tuple[int, ...]
) -> tuple[np.ndarray | None, np.ndarray | None]:
    if model.mirror_vertices is None or model.mirror_joints is None:
        return None, None
    vertex_map = _inverse(kept, model.vertex_count)[model.mirror_vertices[kept]]
    joint_map = _inverse(np.array(bones), model.joint_count)[model.mirror_joints[list(bones)]]
    if (vertex_map < 0).any() or (joint_map < 0).any():
        return None, None
    return vertex_map, joint_map


def _cut_plane(model: SurfaceModel, bones: tuple[int, ...]) -> CutPlane | None:
    if model.cut is None or model.cut.joint not in bones:
        return None
    return CutPlane(bones.index(model.cut.joint), model.cut.point, model.cut.normal)


def part_labels(model: SurfaceModel) -> Int[np.ndarray, " V"]:
    """Number of every vertex's part in the order of ``model.parts``; -1 for a vertex of none."""
    labels = np.full(model.vertex_count, -1, dtype=np.int64)
    for label, members in enumerate(model.parts.values()):
        labels[members] = label
    return labels
