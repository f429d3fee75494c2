"""What our own files hold beyond the family's keys: one JSON header and arrays named ``corporeal_*``."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any, cast

import numpy as np
import scipy.sparse as sp

from corporeal.model.formats.core_arrays import CoreArrays, padded_counts, read_core
from corporeal.model.formats.fields import Source, indices, numbers, text
from corporeal.model.landmarks import LandmarkSet
from corporeal.model.statistics import PoseBlock, PoseMixture
from corporeal.model.surface_model import CutPlane, Side, SurfaceModel

LAYOUT_VERSION = 1
HEADER = "corporeal_header"


def is_native(source: Source) -> bool:
    """Whether the file was written by this package, with its own keys."""
    return HEADER in source.names


def native_keys(model: SurfaceModel) -> dict[str, np.ndarray]:
    """The header and the arrays that the family's layout has no place for."""
    arrays: dict[str, np.ndarray] = {}
    header: dict[str, Any] = {
        "layout": LAYOUT_VERSION,
        "name": model.name,
        "side": model.side,
        "shape_count": model.shape_count,
        "expression_count": model.expression_count,
        "correctives": model.has_correctives,
        "joint_names": list(model.joint_names),
        "parts": list(model.parts),
        "blocks": [
            _block_keys(arrays, f"corporeal_block_{i}", block) for i, block in enumerate(model.pose_blocks)
        ],
        "landmarks": [
            _landmark_keys(arrays, f"corporeal_landmarks_{i}", name, model.landmarks[name])
            for i, name in enumerate(model.landmarks)
        ],
        "notes": dict(model.notes),
        "cut_joint": None if model.cut is None else int(model.cut.joint),
    }
    for i, vertices in enumerate(model.parts.values()):
        arrays[f"corporeal_part_{i}"] = np.asarray(vertices, dtype=np.int32)
    if model.mirror_vertices is not None:
        arrays["corporeal_mirror_vertices"] = model.mirror_vertices.astype(np.int32)
    if model.mirror_joints is not None:
        arrays["corporeal_mirror_joints"] = model.mirror_joints.astype(np.int32)
    if model.cut is not None:
        arrays["corporeal_cut"] = np.stack([model.cut.point, model.cut.normal]).astype(np.float64)
    arrays[HEADER] = np.array(json.dumps(header, sort_keys=True))
    return arrays


def read_native(source: Source) -> SurfaceModel:
    """Rebuild the model from the family's keys, the header and our own arrays.

    Raises:
        ValueError: anything that does not fit together, or a layout of a later version.
        KeyError, TypeError: a header of another structure.
    """
    header = json.loads(text(source, HEADER))
    if header["layout"] != LAYOUT_VERSION:
        raise ValueError(
            f"written in layout {header['layout']}, this version of corporeal reads {LAYOUT_VERSION}"
        )
    core = read_core(source)
    V, K = core.skinning_weights.shape
    shape_directions, expression_directions = _split_directions(core, header)
    return SurfaceModel(
        name=_typed(header["name"], str),
        template=core.template,
        faces=core.faces,
        shape_directions=shape_directions,
        expression_directions=expression_directions,
        joint_regressor=core.joint_regressor,
        skinning_weights=core.skinning_weights,
        parents=core.parents,
        joint_names=_names(header["joint_names"], K),
        pose_directions=core.pose_directions if _typed(header["correctives"], bool) else np.zeros((V, 3, 0)),
        side=_side(header["side"]),
        parts={
            name: indices(source, f"corporeal_part_{i}", (None,), upper=V)
            for i, name in enumerate(_names(header["parts"]))
        },
        pose_blocks=tuple(
            _read_block(source, f"corporeal_block_{i}", record, K)
            for i, record in enumerate(_typed(header["blocks"], list))
        ),
        landmarks={
            _typed(record["name"], str): _read_landmarks(source, f"corporeal_landmarks_{i}", record, V, K)
            for i, record in enumerate(_typed(header["landmarks"], list))
        },
        mirror_vertices=_read_optional(source, "corporeal_mirror_vertices", V),
        mirror_joints=_read_optional(source, "corporeal_mirror_joints", K),
        cut=_read_cut(source, header["cut_joint"], K),
        notes={_typed(key, str): _typed(value, str) for key, value in _typed(header["notes"], dict).items()},
    )


def _split_directions(core: CoreArrays, header: Mapping[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    S, E = _typed(header["shape_count"], int), _typed(header["expression_count"], int)
    shape_columns, expression_columns = padded_counts(S, E)
    if min(S, E) < 0 or core.directions.shape[2] != shape_columns + expression_columns:
        raise ValueError(
            f"'shapedirs' has {core.directions.shape[2]} columns, expected {shape_columns} + "
            f"{expression_columns} for {S} shape and {E} expression directions"
        )
    directions = core.directions
    return directions[:, :, :S].copy(), directions[:, :, shape_columns : shape_columns + E].copy()


def _block_keys(arrays: dict[str, np.ndarray], prefix: str, block: PoseBlock) -> dict[str, Any]:
    arrays[f"{prefix}_joints"] = np.asarray(block.joints, dtype=np.int32)
    arrays[f"{prefix}_mean"] = block.mean.astype(np.float64)
    arrays[f"{prefix}_components"] = block.components.astype(np.float64)
    arrays[f"{prefix}_deviations"] = block.component_deviations.astype(np.float64)
    if block.mixture is not None:
        arrays[f"{prefix}_mixture_weights"] = block.mixture.weights.astype(np.float64)
        arrays[f"{prefix}_mixture_means"] = block.mixture.means.astype(np.float64)
        arrays[f"{prefix}_mixture_covariances"] = block.mixture.covariances.astype(np.float64)
    if block.limits is not None:
        arrays[f"{prefix}_limits"] = block.limits.astype(np.float64)
    return {
        "name": block.name,
        "mean_included": bool(block.mean_included),
        "mixture": block.mixture is not None,
        "limits": block.limits is not None,
    }


def _read_block(source: Source, prefix: str, record: Mapping[str, Any], joint_count: int) -> PoseBlock:
    joints = indices(source, f"{prefix}_joints", (None,), upper=joint_count)
    D = 3 * len(joints)
    components = numbers(source, f"{prefix}_components", (None, D))
    mixture = None
    if _typed(record["mixture"], bool):
        weights = numbers(source, f"{prefix}_mixture_weights", (None,))
        mixture = PoseMixture(
            weights=weights,
            means=numbers(source, f"{prefix}_mixture_means", (len(weights), D)),
            covariances=numbers(source, f"{prefix}_mixture_covariances", (len(weights), D, D)),
        )
    limits = numbers(source, f"{prefix}_limits", (D, 2)) if _typed(record["limits"], bool) else None
    return PoseBlock(
        name=_typed(record["name"], str),
        joints=tuple(int(joint) for joint in joints),
        mean=numbers(source, f"{prefix}_mean", (D,)),
        components=components,
        component_deviations=numbers(source, f"{prefix}_deviations", (len(components),)),
        mean_included=_typed(record["mean_included"], bool),
        mixture=mixture,
        limits=limits,
    )


def _landmark_keys(
    arrays: dict[str, np.ndarray], prefix: str, name: str, landmarks: LandmarkSet
) -> dict[str, Any]:
    weights = sp.csr_matrix(landmarks.weights)
    arrays[f"{prefix}_data"] = weights.data.astype(np.float64)
    arrays[f"{prefix}_indices"] = weights.indices.astype(np.int32)
    arrays[f"{prefix}_indptr"] = weights.indptr.astype(np.int32)
    return {"name": name, "names": list(landmarks.names)}


def _read_landmarks(
    source: Source, prefix: str, record: Mapping[str, Any], vertex_count: int, joint_count: int
) -> LandmarkSet:
    names = _names(record["names"])
    data = numbers(source, f"{prefix}_data", (None,))
    columns = indices(source, f"{prefix}_indices", (len(data),), upper=vertex_count + joint_count)
    row_ends = indices(source, f"{prefix}_indptr", (len(names) + 1,), upper=len(data) + 1)
    if row_ends[0] != 0 or row_ends[-1] != len(data) or np.any(np.diff(row_ends) < 0):
        raise ValueError(f"'{prefix}_indptr' does not divide {len(data)} entries into {len(names)} rows")
    weights = sp.csr_matrix((data, columns, row_ends), shape=(len(names), vertex_count + joint_count))
    return LandmarkSet(names, weights, vertex_count)


def _read_optional(source: Source, key: str, count: int) -> np.ndarray | None:
    return indices(source, key, (count,), upper=count) if key in source.names else None


def _read_cut(source: Source, joint: Any, joint_count: int) -> CutPlane | None:
    if joint is None:
        return None
    if not 0 <= _typed(joint, int) < joint_count:
        raise ValueError(f"the cut plane is fixed to joint {joint} of {joint_count}")
    point, normal = numbers(source, "corporeal_cut", (2, 3))
    return CutPlane(joint, point, normal)


def _names(value: Any, count: int | None = None) -> tuple[str, ...]:
    names = tuple(_typed(name, str) for name in _typed(value, list))
    if count is not None and len(names) != count:
        raise ValueError(f"the header names {len(names)} joints, the arrays have {count}")
    return names


def _side(value: Any) -> Side | None:
    if value not in (None, "left", "right"):
        raise ValueError("the header's side is neither left, right nor null")
    return cast("Side | None", value)


def _typed(value: Any, kind: type) -> Any:
    # bool is an int to isinstance, but not in a header.
    if type(value) is not kind:
        raise TypeError(f"the header holds {type(value).__name__} where {kind.__name__} was expected")
    return value
