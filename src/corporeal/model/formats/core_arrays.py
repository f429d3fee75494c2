"""The arrays that every file of the SMPL family has, official or our own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int

from corporeal.model.formats.fields import Source, indices, numbers, sparse_numbers
from corporeal.model.surface_model import SurfaceModel

Precision = Literal["float64", "float32", "float16"]

# smplx 0.1.28 reads all directions only where a file has exactly this many or more; with fewer it takes the
# first ten of each kind. Zeros fill the gap (and cost next to nothing in a compressed file).
FULL_SHAPE, FULL_EXPRESSION, SHORT = 300, 100, 10
_UNSIGNED_ROOT = 2**32 - 1


@dataclass(frozen=True, eq=False)
class CoreArrays:
    """Checked arrays in float64 and int64; ``directions`` holds shape, then expression, with any padding."""

    template: Float[np.ndarray, "V 3"]
    faces: Int[np.ndarray, "F 3"]
    directions: Float[np.ndarray, "V 3 C"]
    pose_directions: Float[np.ndarray, "V 3 P"]
    joint_regressor: sp.csr_matrix
    skinning_weights: Float[np.ndarray, "V K"]
    parents: Int[np.ndarray, " K"]


def read_core(source: Source) -> CoreArrays:
    """Read and check what every file must have.

    Raises:
        ValueError: a key is missing, or its content is not what the family's layout asks for.
    """
    template = numbers(source, "v_template", (None, 3))
    V = len(template)
    if V == 0:
        raise ValueError("'v_template' holds no vertices")
    parents = _read_parents(source)
    K = len(parents)
    regressor = sparse_numbers(source, "J_regressor", (K, V))
    weights = numbers(source, "weights", (V, K))
    _check_sums("weights", weights.sum(axis=1))
    _check_sums("J_regressor", np.asarray(regressor.sum(axis=1)).ravel())
    return CoreArrays(
        template=template,
        faces=indices(source, "f", (None, 3), upper=V),
        directions=numbers(source, "shapedirs", (V, 3, None)),
        pose_directions=numbers(source, "posedirs", (V, 3, 9 * (K - 1))),
        joint_regressor=regressor,
        skinning_weights=weights,
        parents=parents,
    )


def core_keys(model: SurfaceModel, precision: Precision) -> dict[str, np.ndarray]:
    """The same arrays under the family's key names, padded so that smplx reads every direction.

    Raises:
        ValueError: more directions than the layout of a model with expressions has room for.
    """
    K = model.joint_count
    pose_directions = model.pose_directions
    if not model.has_correctives:
        pose_directions = np.zeros((model.vertex_count, 3, 9 * (K - 1)))
    return {
        "v_template": model.template.astype(np.float64),
        "f": model.faces.astype(np.int32),
        "shapedirs": _padded_directions(model).astype(precision),
        "posedirs": pose_directions.astype(precision),
        "J_regressor": model.joint_regressor.toarray().astype(np.float64),
        "weights": model.skinning_weights.astype(np.float64),
        "kintree_table": np.stack([model.parents.astype(np.int64), np.arange(K)]),
    }


def padded_counts(shape_count: int, expression_count: int) -> tuple[int, int]:
    """Columns for shape and for expression in the file, padding included (see ``FULL_SHAPE``).

    Raises:
        ValueError: expressions, and more directions than 300 and 100.
    """
    if expression_count == 0:
        return (max(shape_count, FULL_SHAPE) if shape_count > SHORT else SHORT), 0
    if shape_count > FULL_SHAPE or expression_count > FULL_EXPRESSION:
        raise ValueError(
            f"{shape_count} shape and {expression_count} expression directions do not fit the layout of the "
            f"SMPL family ({FULL_SHAPE} and {FULL_EXPRESSION}); drop the last ones before saving"
        )
    if shape_count <= SHORT and expression_count <= SHORT:
        return SHORT, SHORT
    return FULL_SHAPE, FULL_EXPRESSION


def _padded_directions(model: SurfaceModel) -> np.ndarray:
    shape_columns, expression_columns = padded_counts(model.shape_count, model.expression_count)
    directions = np.zeros((model.vertex_count, 3, shape_columns + expression_columns))
    directions[:, :, : model.shape_count] = model.shape_directions
    directions[:, :, shape_columns : shape_columns + model.expression_count] = model.expression_directions
    return directions


def _read_parents(source: Source) -> np.ndarray:
    table = indices(source, "kintree_table", (2, None), lower=-1, upper=_UNSIGNED_ROOT + 1)
    parents = table[0].copy()
    if len(parents) == 0:
        raise ValueError("'kintree_table' holds no joints")
    if parents[0] == _UNSIGNED_ROOT:
        parents[0] = -1
    if parents[0] != -1 or np.any(parents[1:] < 0) or np.any(parents[1:] >= np.arange(1, len(parents))):
        raise ValueError("'kintree_table' is no tree with the root first and parents before their children")
    return parents


def _check_sums(key: str, sums: np.ndarray) -> None:
    worst = np.abs(sums - 1).max(initial=0.0)
    if worst > 1e-3:
        raise ValueError(f"{key!r} has rows that do not sum to 1 (off by {worst:.3g})")
