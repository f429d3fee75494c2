"""Where the curvature of a mesh has its entries, and scattering of per-point quadratics into it.

The residual of a scan point is linear in the three corners of a face, r = s - B v, so that B^T W B has the
sparsity of the mesh whatever the number of points. Measured on a 778-vertex hand with 61 parameters and
50,000 points: 3.4 ms against 9.2 ms for gathered rows.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int

from corporeal.solve.curvature import BlockCurvature, PerAxisCurvature
from corporeal.terms.mesh_pattern_kernels import scatter_blocks, scatter_gradient, scatter_per_axis


class MeshPattern:
    """Sparsity of one topology: every pair of vertices that share a face, diagonal included."""

    def __init__(self, faces: Int[np.ndarray, "F 3"], vertex_count: int) -> None:
        faces = np.asarray(faces, dtype=np.int64)
        rows = np.repeat(faces, 3, axis=1).ravel()
        columns = np.tile(faces, (1, 3)).ravel()
        diagonal = np.arange(vertex_count)
        keys = np.concatenate([rows, diagonal]) * vertex_count + np.concatenate([columns, diagonal])
        unique, inverse = np.unique(keys, return_inverse=True)
        self.faces = faces
        self.vertex_count = vertex_count
        self.indices = (unique % vertex_count).astype(np.int32)
        self.indptr = np.searchsorted(unique // vertex_count, np.arange(vertex_count + 1)).astype(np.int32)
        self._face_slots = inverse.ravel()[: 9 * len(faces)].reshape(-1, 9)
        self._diagonal_slots = inverse.ravel()[9 * len(faces) :]

    def gradient(
        self, face: Int[np.ndarray, " n"], barycentric: Float[np.ndarray, "n 3"],
        vectors: Float[np.ndarray, "n 3"],
    ) -> Float[np.ndarray, "V 3"]:  # fmt: skip
        """Sum of B^T vectors."""
        return scatter_gradient(self.faces, face, barycentric, vectors, self.vertex_count)

    def per_axis(
        self,
        face: Int[np.ndarray, " n"],
        barycentric: Float[np.ndarray, "n 3"],
        weight: Float[np.ndarray, " n"],
    ) -> PerAxisCurvature:
        """B^T diag(weight) B."""
        data = scatter_per_axis(self._face_slots, face, barycentric, weight, len(self.indices))
        return PerAxisCurvature(self._matrix(data))

    def blocks(
        self, face: Int[np.ndarray, " n"], barycentric: Float[np.ndarray, "n 3"],
        metric: Float[np.ndarray, "n 3 3"],
    ) -> BlockCurvature:  # fmt: skip
        """B^T diag(metric) B with a symmetric 3 x 3 metric per point."""
        data = scatter_blocks(self._face_slots, face, barycentric, metric, len(self.indices))
        return BlockCurvature(self.indptr, self.indices, data)

    def diagonal(self, weight: Float[np.ndarray, " V"]) -> PerAxisCurvature:
        """A weight per vertex."""
        data = np.zeros(len(self.indices))
        data[self._diagonal_slots] = weight
        return PerAxisCurvature(self._matrix(data))

    def diagonal_blocks(self, metric: Float[np.ndarray, "V 3 3"]) -> BlockCurvature:
        """A 3 x 3 metric per vertex."""
        data = np.zeros((len(self.indices), 3, 3))
        data[self._diagonal_slots] = metric
        return BlockCurvature(self.indptr, self.indices, data)

    def _matrix(self, data: np.ndarray) -> sp.csr_matrix:
        shape = (self.vertex_count, self.vertex_count)
        return sp.csr_matrix((data, self.indices, self.indptr), shape=shape)
