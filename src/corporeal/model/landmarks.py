"""Named landmarks: affine combinations of a model's vertices and joints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int


@dataclass(frozen=True, eq=False)
class LandmarkSet:
    """Ordered landmarks; each is an affine combination of posed vertices and posed joints.

    A surface landmark is the case of three vertices with barycentric weights, a joint the case of one joint.

    Attributes:
        names: one name per landmark, in the order of the set (for instance MediaPipe's).
        weights: (N, V + K) sparse; rows sum to one. Columns are the vertices, then the joints.
        vertex_count: V, where the joint columns begin.
    """

    names: tuple[str, ...]
    weights: sp.csr_matrix
    vertex_count: int

    def __post_init__(self) -> None:
        if self.weights.shape[0] != len(self.names):
            raise ValueError(f"weights: {self.weights.shape[0]} rows for {len(self.names)} landmark names")
        sums = np.asarray(self.weights.sum(axis=1)).ravel()
        if len(sums) and np.abs(sums - 1).max() > 1e-6:
            raise ValueError("weights: every row must sum to 1, or the landmarks do not move with the model")

    @classmethod
    def from_surface(
        cls, names: Sequence[str], corners: Int[np.ndarray, "n 3"], barycentric: Float[np.ndarray, "n 3"],
        vertex_count: int, joint_count: int,
    ) -> LandmarkSet:  # fmt: skip
        """Landmarks on triangles: ``corners`` are vertex indices, ``barycentric`` their weights."""
        rows = np.repeat(np.arange(len(names)), 3)
        shape = (len(names), vertex_count + joint_count)
        weights = sp.csr_matrix((barycentric.ravel(), (rows, corners.ravel())), shape=shape)
        return cls(tuple(names), weights, vertex_count)

    def positions(
        self, vertices: Float[np.ndarray, "V 3"], joints: Float[np.ndarray, "K 3"]
    ) -> Float[np.ndarray, "N 3"]:
        """Landmarks of one posed surface, in the frame and unit of its vertices."""
        return np.asarray(self.weights @ np.concatenate([vertices, joints]))

    def reordered(self, names: Sequence[str]) -> LandmarkSet:
        """The same landmarks in another order; a name that the set does not hold raises ``KeyError``."""
        rows = [self.names.index(name) if name in self.names else self._unknown(name) for name in names]
        return LandmarkSet(tuple(names), self.weights[rows], self.vertex_count)

    def _unknown(self, name: str) -> int:
        raise KeyError(f"landmark {name!r} is not among {', '.join(self.names)}")
