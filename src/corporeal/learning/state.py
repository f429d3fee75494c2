"""What is being learned, and the registrations that it is learned from."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int

from corporeal.learning import skinning_kernels as kernels

# Registrations posed at once: 64 hands of 3,000 vertices are 14 MB.
_CHUNK = 64


class WeightTable(NamedTuple):
    """Skinning weights by vertex, as the kernels read them."""

    starts: Int[np.ndarray, " V1"]
    joints: Int[np.ndarray, " n"]
    values: Float[np.ndarray, " n"]


class ChainTable(NamedTuple):
    """Joints that move a vertex, with all their ancestors, parents first."""

    starts: Int[np.ndarray, " V1"]
    joints: Int[np.ndarray, " n"]


@dataclass(frozen=True, eq=False)
class Registrations:
    """The data: N registrations of H hands.

    Attributes:
        vertices: (N, V, 3) metres.
        hands: (N,) number of the hand.
        importance: (N,) weights of the registrations in the templates.
    """

    vertices: Float[np.ndarray, "N V 3"]
    hands: Int[np.ndarray, " N"]
    importance: Float[np.ndarray, " N"]


class Posed(NamedTuple):
    """Some registrations under the model: ``rows`` of all, their motions, joints and surfaces at rest."""

    rows: slice
    motions: Float[np.ndarray, "n K 12"]
    placed: Float[np.ndarray, "n K 3"]
    rest: Float[np.ndarray, "n V 3"]


@dataclass(frozen=True, eq=False)
class LearningState:
    """All variables.

    Attributes:
        templates: (H, V, 3) personal templates at the zero pose, metres.
        joints: (H, K, 3) their joints.
        weights: (V, K) skinning weights.
        pose_directions: (P, 3 V) offsets per pose feature, P = 9 (K - 1).
        regressor: (K, V) sparse.
        rotations: (N, K, 3, 3) of every joint against its parent.
        translations: (N, 3) metres.
        parents: (K,).
    """

    templates: Float[np.ndarray, "H V 3"]
    joints: Float[np.ndarray, "H K 3"]
    weights: Float[np.ndarray, "V K"]
    pose_directions: Float[np.ndarray, "P V3"]
    regressor: sp.csr_matrix
    rotations: Float[np.ndarray, "N K 3 3"]
    translations: Float[np.ndarray, "N 3"]
    parents: Int[np.ndarray, " K"]

    @property
    def has_correctives(self) -> bool:
        """Whether any corrective was learned yet."""
        return bool(self.pose_directions.any())

    def weight_table(self) -> WeightTable:
        """The non-zero weights."""
        table = sp.csr_matrix(self.weights)
        return WeightTable(table.indptr.astype(np.int64), table.indices.astype(np.int64), table.data)

    def chain_table(self) -> ChainTable:
        """Who moves whom."""
        moved = self.weights != 0
        for joint in range(len(self.parents) - 1, 0, -1):
            moved[:, self.parents[joint]] |= moved[:, joint]
        table = sp.csr_matrix(moved)
        return ChainTable(table.indptr.astype(np.int64), table.indices.astype(np.int64))

    def features(self, rows: slice = slice(None)) -> Float[np.ndarray, "n P"]:
        """Elements of the rotation matrices after the root minus the identity (equation 3)."""
        turned = self.rotations[rows, 1:] - np.eye(3)
        return turned.reshape(len(turned), -1)

    def motions(
        self, hands: Int[np.ndarray, " N"], rows: slice = slice(None)
    ) -> tuple[Float[np.ndarray, "n K 12"], Float[np.ndarray, "n K 3"]]:
        """What skinning blends, and where the joints are."""
        rotations, translations = self.rotations[rows], self.translations[rows]
        motions, placed = np.empty((*rotations.shape[:2], 12)), np.empty((*rotations.shape[:2], 3))
        kernels.joint_motions(
            rotations, self.joints, hands[rows], translations, self.parents, motions, placed
        )
        return motions, placed

    def offsets(self, rows: slice) -> Float[np.ndarray, "n V 3"]:
        """Pose correctives of some registrations."""
        features = self.features(rows)
        if not self.has_correctives:
            return np.zeros((len(features), *self.templates.shape[1:]))
        return (features @ self.pose_directions).reshape(len(features), -1, 3)

    def posed(self, data: Registrations) -> Iterator[Posed]:
        """All registrations under the model, some at a time."""
        for rows in chunks(len(data.hands)):
            motions, placed = self.motions(data.hands, rows)
            rest = self.offsets(rows)
            rest += self.templates[data.hands[rows]]
            yield Posed(rows, motions, placed, rest)

    def squared_errors(self, data: Registrations) -> Float[np.ndarray, " N"]:
        """Sum over the vertices of every registration, square metres."""
        errors, table = np.empty(len(data.hands)), self.weight_table()
        for posed in self.posed(data):
            kernels.squared_errors(
                table, posed.motions, posed.rest, data.vertices[posed.rows], errors[posed.rows]
            )
        return errors


def chunks(count: int) -> Iterator[slice]:
    """Slices that cover ``count`` rows."""
    for first in range(0, count, _CHUNK):
        yield slice(first, min(first + _CHUNK, count))
