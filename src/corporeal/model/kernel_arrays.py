"""A model's arrays in the form that the kernels of evaluation and Jacobian read."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int


class KernelArrays(NamedTuple):
    """Float64, C-contiguous. A named tuple, because numba takes it whole; R = 3 V rows, one per coordinate.

    C counts shape and expression directions together, shape first. The three sparse tables have one row per
    vertex: ``starts[i]`` to ``starts[i + 1]`` are its entries.

    Attributes:
        template: (R,).
        directions: (R, C).
        joint_template: (K, 3), the regressor applied to the template.
        joint_directions: (K, 3, C), the regressor applied to the directions: joints are linear in shape.
        parents: (K,).
        weight_starts: (V + 1,).
        weight_joints: joints with a skinning weight.
        weight_values: the weights.
        chain_starts: (V + 1,).
        chain_joints: joints that move a vertex, with all their ancestors, ascending (parents first).
        corrected_starts: (V + 1,).
        corrected_joints: joints (1..K-1) whose pose correctives move a vertex.
        correctives: (p, 3, 9) pose directions of these joints alone. A body's joints move few vertices each;
            all its directions, 210 MB of which 24 are not zero, were most of the time of an evaluation.
    """

    template: Float[np.ndarray, " R"]
    directions: Float[np.ndarray, "R C"]
    joint_template: Float[np.ndarray, "K 3"]
    joint_directions: Float[np.ndarray, "K 3 C"]
    parents: Int[np.ndarray, " K"]
    weight_starts: Int[np.ndarray, " V1"]
    weight_joints: Int[np.ndarray, " w"]
    weight_values: Float[np.ndarray, " w"]
    chain_starts: Int[np.ndarray, " V1"]
    chain_joints: Int[np.ndarray, " c"]
    corrected_starts: Int[np.ndarray, " V1"]
    corrected_joints: Int[np.ndarray, " p"]
    correctives: Float[np.ndarray, "p 3 9"]

    def of_vertices(self, vertices: Int[np.ndarray, " n"]) -> KernelArrays:
        """The same for some vertices alone, in the order given; joints stay those of the whole surface."""
        rows = (3 * vertices[:, None] + np.arange(3)).ravel()
        weights, weight_starts = _entries(self.weight_starts, vertices)
        chain, chain_starts = _entries(self.chain_starts, vertices)
        corrected, corrected_starts = _entries(self.corrected_starts, vertices)
        return self._replace(
            template=self.template[rows],
            directions=self.directions[rows],
            weight_starts=weight_starts,
            weight_joints=self.weight_joints[weights],
            weight_values=self.weight_values[weights],
            chain_starts=chain_starts,
            chain_joints=self.chain_joints[chain],
            corrected_starts=corrected_starts,
            corrected_joints=self.corrected_joints[corrected],
            correctives=self.correctives[corrected],
        )


def kernel_arrays(
    *,
    template: Float[np.ndarray, "V 3"],
    directions: Float[np.ndarray, "V 3 C"],
    pose_directions: Float[np.ndarray, "V 3 P"],
    joint_regressor: sp.csr_matrix,
    skinning_weights: Float[np.ndarray, "V K"],
    parents: Int[np.ndarray, " K"],
) -> KernelArrays:
    """Build from a model's fields."""
    V, K = skinning_weights.shape
    C, P = directions.shape[2], pose_directions.shape[2]
    moved = skinning_weights != 0
    for joint in range(K - 1, 0, -1):
        moved[:, parents[joint]] |= moved[:, joint]
    corrected = np.zeros((V, K), dtype=bool)
    if P:
        corrected[:, 1:] = (pose_directions.reshape(V, 3, K - 1, 9) != 0).any(axis=(1, 3))
    joint_template = joint_regressor @ template.astype(np.float64)
    joint_directions = joint_regressor @ directions.reshape(V, 3 * C).astype(np.float64)
    weights, chain, correction = (sp.csr_matrix(table) for table in (skinning_weights, moved, corrected))
    return KernelArrays(
        template=_double(template.reshape(3 * V)),
        directions=_double(directions.reshape(3 * V, C)),
        joint_template=_double(joint_template),
        joint_directions=_double(joint_directions.reshape(K, 3, C)),
        parents=parents.astype(np.int64),
        weight_starts=weights.indptr.astype(np.int64),
        weight_joints=weights.indices.astype(np.int64),
        weight_values=_double(weights.data),
        chain_starts=chain.indptr.astype(np.int64),
        chain_joints=chain.indices.astype(np.int64),
        corrected_starts=correction.indptr.astype(np.int64),
        corrected_joints=correction.indices.astype(np.int64),
        correctives=_packed_correctives(pose_directions, correction),
    )


def _packed_correctives(
    pose_directions: Float[np.ndarray, "V 3 P"], corrected: sp.csr_matrix
) -> Float[np.ndarray, "p 3 9"]:
    """See ``KernelArrays.correctives``; ``corrected`` (V, K) says which joints move which vertices."""
    vertices = np.repeat(np.arange(corrected.shape[0]), np.diff(corrected.indptr))
    by_joint = pose_directions.reshape(corrected.shape[0], 3, -1, 9)
    packed = by_joint[vertices, :, corrected.indices - 1]
    return _double(packed)


def _entries(
    starts: Int[np.ndarray, " V1"], rows: Int[np.ndarray, " n"]
) -> tuple[Int[np.ndarray, " e"], Int[np.ndarray, " n1"]]:
    """Of a sparse table's rows: their entries one after the other, and where each row begins among them."""
    counts = starts[rows + 1] - starts[rows]
    begins = np.concatenate([[0], np.cumsum(counts)])
    return np.repeat(starts[rows] - begins[:-1], counts) + np.arange(begins[-1]), begins


def _double(array: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(array, dtype=np.float64)
