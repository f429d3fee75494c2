"""The official layouts of MANO, SMPL, SMPL+H, SMPL-X and FLAME: one reader, led by the table of families."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from corporeal.model.formats.core_arrays import CoreArrays, read_core
from corporeal.model.formats.families import (
    EXPRESSION_SPLITS,
    FAMILIES,
    BlockLayout,
    Family,
    family_of_tree,
)
from corporeal.model.formats.fields import Source, indices, numbers
from corporeal.model.hand_landmarks import HAND_21, hand_landmarks, hand_parts
from corporeal.model.landmarks import LandmarkSet
from corporeal.model.statistics import PoseBlock
from corporeal.model.surface_model import Side, SurfaceModel

FACE_LANDMARKS = "face"


def read_official(source: Source) -> SurfaceModel:
    """Read a file of one of the five families; which one is told from its kinematic tree.

    The hand statistics count coefficients from the mean, as the families do (``flat_hand_mean=False`` of
    smplx). Where a file has components but no ``hands_coeffs``, their deviations are unknown: they are set to
    1 and ``notes`` says so.

    Raises:
        ValueError: a key is missing, its content does not fit, or the tree is of no known family.
    """
    core = read_core(source)
    family = family_of_tree(core.parents)
    if family is None:
        known = ", ".join(f"{f.title} {len(f.parents)}" for f in FAMILIES)
        raise ValueError(
            f"its tree of {len(core.parents)} joints is of no known family (joints: {known}); "
            f"the file holds {', '.join(sorted(source.names)[:40])}"
        )
    shape_count, expression_count = _split(family, core.directions.shape[2])
    directions = core.directions
    return SurfaceModel(
        name=family.name,
        template=core.template,
        faces=core.faces,
        shape_directions=directions[:, :, :shape_count].copy(),
        expression_directions=directions[:, :, shape_count : shape_count + expression_count].copy(),
        joint_regressor=core.joint_regressor,
        skinning_weights=core.skinning_weights,
        parents=core.parents,
        joint_names=family.joint_names,
        pose_directions=core.pose_directions,
        side=_side_of_fingers(core) if family.single_hand else None,
        pose_blocks=tuple(_read_block(source, layout) for layout in family.blocks),
        landmarks=_landmarks(source, core, family),
        parts=hand_parts(core.skinning_weights, family.joint_names) if family.single_hand else {},
        notes=_notes(source, family),
    )


def statistics_keys(model: SurfaceModel) -> dict[str, np.ndarray]:
    """Hand statistics and face landmarks under the family's key names; empty for a model of no known family.

    Components are padded with zeros to as many as there are numbers: smplx takes any count up to that.
    ``hands_coeffs`` holds two rows, plus and minus one deviation: readers take only deviations from it.
    """
    family = family_of_tree(model.parents)
    if family is None:
        return {}
    arrays: dict[str, np.ndarray] = {}
    blocks = {block.name: block for block in model.pose_blocks}
    for layout in family.blocks:
        if layout.hand_suffix is None:
            continue
        block = blocks.get(layout.name, PoseBlock.plain(layout.name, layout.joints))
        D, C = len(block.mean), len(block.components)
        components, deviations = np.zeros((max(C, D), D)), np.zeros(max(C, D))
        components[:C], deviations[:C] = block.components, block.component_deviations
        arrays[f"hands_mean{layout.hand_suffix}"] = block.mean.astype(np.float64)
        arrays[f"hands_components{layout.hand_suffix}"] = components
        arrays[f"hands_coeffs{layout.hand_suffix}"] = np.stack([deviations, -deviations])
    if family.expressions:
        arrays["lmk_faces_idx"], arrays["lmk_bary_coords"] = _landmarks_on_faces(model)
    return arrays


def _split(family: Family, column_count: int) -> tuple[int, int]:
    if not family.expressions:
        return column_count, 0
    if column_count not in EXPRESSION_SPLITS:
        known = ", ".join(f"{n} = {s} + {e}" for n, (s, e) in EXPRESSION_SPLITS.items())
        raise ValueError(
            f"'shapedirs' has {column_count} columns; how they divide into shape and expression is known for "
            f"{known}"
        )
    return EXPRESSION_SPLITS[column_count]


def _side_of_fingers(core: CoreArrays) -> Side:
    joints = core.joint_regressor @ core.template
    # A right hand points along -x, in MANO's files and in our conventions.
    return "right" if joints[1:, 0].mean() < joints[0, 0] else "left"


def _read_block(source: Source, layout: BlockLayout) -> PoseBlock:
    plain = PoseBlock.plain(layout.name, layout.joints)
    if layout.hand_suffix is None or f"hands_mean{layout.hand_suffix}" not in source.names:
        return plain
    D = len(plain.mean)
    mean = numbers(source, f"hands_mean{layout.hand_suffix}", (D,))
    components = numbers(source, f"hands_components{layout.hand_suffix}", (None, D))
    deviations = np.ones(len(components))
    if f"hands_coeffs{layout.hand_suffix}" in source.names:
        coefficients = numbers(source, f"hands_coeffs{layout.hand_suffix}", (None, len(components)))
        deviations = coefficients.std(axis=0) if len(coefficients) else deviations
    return PoseBlock(layout.name, layout.joints, mean, components, deviations, mean_included=True)


def _notes(source: Source, family: Family) -> dict[str, str]:
    notes = {
        "source": f"file in the official layout of {family.title}",
        "licence": "the terms under which that file was obtained",
    }
    suffixes = [layout.hand_suffix for layout in family.blocks if layout.hand_suffix is not None]
    if any(
        f"hands_components{s}" in source.names and f"hands_coeffs{s}" not in source.names for s in suffixes
    ):
        notes["statistics"] = (
            "the file has no hands_coeffs: deviations of hand components are unknown, 1 stands"
        )
    return notes


def _landmarks(source: Source, core: CoreArrays, family: Family) -> dict[str, LandmarkSet]:
    if family.expressions:
        return _read_landmarks(source, core)
    if not family.single_hand:
        return {}
    joints = np.asarray(core.joint_regressor @ core.template)
    return {HAND_21: hand_landmarks(core.template, joints, core.skinning_weights, family.joint_names)}


def _read_landmarks(source: Source, core: CoreArrays) -> dict[str, LandmarkSet]:
    if "lmk_faces_idx" not in source.names:
        return {}
    faces = indices(source, "lmk_faces_idx", (None,), upper=len(core.faces))
    barycentric = numbers(source, "lmk_bary_coords", (len(faces), 3))
    sums = barycentric.sum(axis=1, keepdims=True)
    if np.abs(sums - 1).max(initial=0.0) > 1e-3:
        raise ValueError("'lmk_bary_coords' has rows that do not sum to 1")
    V, K = core.skinning_weights.shape
    names = [f"{FACE_LANDMARKS}_{i}" for i in range(len(faces))]
    landmarks = LandmarkSet.from_surface(names, core.faces[faces], barycentric / sums, V, K)
    return {FACE_LANDMARKS: landmarks} if names else {}


def _landmarks_on_faces(
    model: SurfaceModel,
) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, "n 3"]]:
    """Face index and barycentric weights of each face landmark; none where one lies on no single triangle."""
    nothing = np.zeros(0, dtype=np.int64), np.zeros((0, 3))
    landmarks = model.landmarks.get(FACE_LANDMARKS)
    if landmarks is None:
        return nothing
    faces, barycentric = [], []
    for row in landmarks.weights:
        columns = row.indices[row.data != 0]
        holds_all = np.ones(len(model.faces), dtype=bool)
        for column in columns:
            holds_all &= (model.faces == column).any(axis=1)
        candidates = np.flatnonzero(holds_all)
        if len(columns) == 0 or len(candidates) == 0:
            return nothing
        faces.append(int(candidates[0]))
        barycentric.append([float(row[0, corner]) for corner in model.faces[candidates[0]]])
    return np.array(faces, dtype=np.int64), np.array(barycentric).reshape(-1, 3)
