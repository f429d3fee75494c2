"""A model's arrays in the form that the kernels of evaluation and Jacobian read."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int


@dataclass(frozen=True, eq=False)
class SparseRows:
    """Non-zeros of a matrix with one row per vertex.

    Attributes:
        starts: (V + 1,) where each vertex's entries begin.
        columns: (n,) joint of each entry.
        values: (n,) the entries; empty where only the pattern matters.
    """

    starts: Int[np.ndarray, " V1"]
    columns: Int[np.ndarray, " n"]
    values: Float[np.ndarray, " m"]

    @classmethod
    def of_matrix(cls, matrix: np.ndarray) -> SparseRows:
        """Keep the non-zeros, in ascending order of columns."""
        rows = sp.csr_matrix(matrix)
        return cls(rows.indptr.astype(np.int64), rows.indices.astype(np.int64), rows.data.astype(np.float64))


@dataclass(frozen=True, eq=False)
class KernelArrays:
    """Float64, C-contiguous; C counts shape and expression directions together, shape first.

    Attributes:
        template: (V, 3).
        directions: (V, 3, C).
        pose_directions: (V, 3, P).
        joint_template: (K, 3), the regressor applied to the template.
        joint_directions: (K, 3, C), the regressor applied to the directions: joints are linear in shape.
        parents: (K,).
        weights: skinning weights of every vertex.
        chain: per vertex the joints that move it, with all their ancestors, ascending (parents first).
        corrected: per vertex the joints (1..K-1) whose pose correctives move it; pattern only.
    """

    template: Float[np.ndarray, "V 3"]
    directions: Float[np.ndarray, "V 3 C"]
    pose_directions: Float[np.ndarray, "V 3 P"]
    joint_template: Float[np.ndarray, "K 3"]
    joint_directions: Float[np.ndarray, "K 3 C"]
    parents: Int[np.ndarray, " K"]
    weights: SparseRows
    chain: SparseRows
    corrected: SparseRows

    @classmethod
    def of_fields(
        cls,
        *,
        template: np.ndarray,
        directions: np.ndarray,
        pose_directions: np.ndarray,
        joint_regressor: sp.csr_matrix,
        skinning_weights: np.ndarray,
        parents: np.ndarray,
    ) -> KernelArrays:
        """Build from a model's fields; arrays that are float64 and contiguous are not copied."""
        V, K = skinning_weights.shape
        C = directions.shape[2]
        regressor = sp.csr_matrix(joint_regressor, dtype=np.float64)
        moved = skinning_weights != 0
        for joint in range(K - 1, 0, -1):
            moved[:, parents[joint]] |= moved[:, joint]
        moved[:, 0] = True
        corrected = np.zeros((V, K), dtype=bool)
        if pose_directions.shape[2]:
            corrected[:, 1:] = (pose_directions.reshape(V, 3, K - 1, 9) != 0).any(axis=(1, 3))
        joint_directions = regressor @ np.asarray(directions, dtype=np.float64).reshape(V, 3 * C)
        return cls(
            template=np.ascontiguousarray(template, dtype=np.float64),
            directions=np.ascontiguousarray(directions, dtype=np.float64),
            pose_directions=np.ascontiguousarray(pose_directions, dtype=np.float64),
            joint_template=np.ascontiguousarray(regressor @ template, dtype=np.float64),
            joint_directions=np.ascontiguousarray(joint_directions.reshape(K, 3, C)),
            parents=np.asarray(parents, dtype=np.int64),
            weights=SparseRows.of_matrix(skinning_weights),
            chain=SparseRows.of_matrix(moved),
            corrected=SparseRows.of_matrix(corrected),
        )
