"""The fields that follow from a model's parameters, and their Jacobians, for the solvers."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float

from corporeal.model.jacobian import (
    Evaluated,
    GroupedLinearised,
    ParameterColumns,
    SomeVertices,
    evaluate,
    linearise_groups,
)
from corporeal.model.landmarks import LandmarkSet
from corporeal.model.surface_model import SurfaceModel
from corporeal.solve.grouped_slopes import GroupedSlopes, SlopeGroup

MODEL = "model"
LANDMARKS = "landmarks"


@dataclass(frozen=True, eq=False)
class ModelParameters:
    """One posed instance: what registration and fitting solve for.

    Attributes:
        translation: (3,) metres.
        pose: (K, 3) axis-angle, the root first, radians.
        shape: (s,) coefficients of the first s shape directions.
    """

    translation: Float[np.ndarray, "3"]
    pose: Float[np.ndarray, "K 3"]
    shape: Float[np.ndarray, " s"]

    def vector(self) -> Float[np.ndarray, " Q"]:
        """As the solvers' parameter vector: translation, pose, shape."""
        return np.concatenate([self.translation, self.pose.ravel(), self.shape])


class ModelFields:
    """Posed vertices and landmarks of a model as derived fields of its parameter vector."""

    def __init__(
        self,
        model: SurfaceModel,
        *,
        shape_count: int,
        landmarks: LandmarkSet | None = None,
        correctives: bool = True,
    ) -> None:
        self.model = model
        self.shape_count = shape_count
        self._landmarks = landmarks
        self.correctives = correctives

    @cached_property
    def landmarks_alone(self) -> LandmarkFields:
        """The landmarks' field without that of the vertices."""
        if self._landmarks is None:
            raise ValueError("landmarks: there are none")
        return LandmarkFields(self, self._landmarks)

    @cached_property
    def columns(self) -> ParameterColumns:
        """Slices of the parameter vector."""
        return ParameterColumns.of_counts(self.model.joint_count, self.shape_count, 0)

    def parameters(self, vector: Float[np.ndarray, " Q"]) -> ModelParameters:
        """The named parts of a parameter vector."""
        columns = self.columns
        return ModelParameters(
            vector[columns.translation].copy(),
            vector[columns.pose].reshape(-1, 3).copy(),
            vector[columns.shape].copy(),
        )

    def evaluated(self, vector: Float[np.ndarray, " Q"]) -> Evaluated:
        """Posed vertices, joints and transforms."""
        p = self.parameters(vector)
        return evaluate(self.model, p.shape, p.pose, p.translation, correctives=self.correctives)

    def derive(self, vector: Float[np.ndarray, " Q"]) -> dict[str, np.ndarray]:
        """Field values: "model" (V, 3) and, with a landmark set, "landmarks" (N, 3); metres."""
        posed = self.evaluated(vector)
        fields = {MODEL: posed.vertices}
        if self._landmarks is not None:
            fields[LANDMARKS] = self._landmarks.positions(posed.vertices, posed.joints)
        return fields

    def differentiate(self, vector: Float[np.ndarray, " Q"]) -> dict[str, np.ndarray | GroupedSlopes]:
        """Jacobians of the fields, each (n, 3, Q); that of the vertices by groups."""
        p = self.parameters(vector)
        linear = linearise_groups(self.model, p.shape, p.pose, correctives=self.correctives)
        parts = zip(self.model.vertex_groups, linear.group_columns, linear.group_jacobians, strict=True)
        slopes = GroupedSlopes(
            tuple(SlopeGroup(len(of.own), of.around, columns, jacobian) for of, columns, jacobian in parts),
            (self.model.vertex_count, 3, self.columns.count),
        )
        fields: dict[str, np.ndarray | GroupedSlopes] = {MODEL: slopes}
        if self._landmarks is not None:
            fields[LANDMARKS] = _landmark_jacobian(self._landmarks, linear, slopes)
        return fields


class LandmarkFields:
    """Landmarks of a model as the one derived field of its parameter vector: no other vertex is posed."""

    def __init__(self, whole: ModelFields, landmarks: LandmarkSet) -> None:
        """Take from the fields of a model what the landmarks need.

        Args:
            whole: fields of the model.
            landmarks: of the model.
        """
        used = np.unique(landmarks.weights[:, : landmarks.vertex_count].indices)
        self._whole = whole
        self._vertices = SomeVertices(whole.model, used)
        of_vertices = landmarks.weights[:, used]
        of_joints = landmarks.weights[:, landmarks.vertex_count :]
        weights = sp.hstack([of_vertices, of_joints]).tocsr()
        self._landmarks = LandmarkSet(landmarks.names, weights, len(used))

    def derive(self, vector: Float[np.ndarray, " Q"]) -> dict[str, np.ndarray]:
        """The field "landmarks" (N, 3), metres."""
        p, correctives = self._whole.parameters(vector), self._whole.correctives
        posed = self._vertices.evaluate(p.shape, p.pose, p.translation, correctives=correctives)
        return {LANDMARKS: self._landmarks.positions(posed.vertices, posed.joints)}

    def differentiate(self, vector: Float[np.ndarray, " Q"]) -> dict[str, np.ndarray | GroupedSlopes]:
        """Its Jacobian (N, 3, Q)."""
        p, correctives = self._whole.parameters(vector), self._whole.correctives
        slopes = np.concatenate(self._vertices.linearise(p.shape, p.pose, correctives=correctives))
        jacobian = np.asarray(self._landmarks.weights @ slopes.reshape(len(slopes), -1))
        return {LANDMARKS: jacobian.reshape(len(jacobian), *slopes.shape[1:])}


def _landmark_jacobian(
    landmarks: LandmarkSet, linear: GroupedLinearised, slopes: GroupedSlopes
) -> Float[np.ndarray, "N 3 Q"]:
    V, _, Q = slopes.shape
    K, N = len(linear.joint_jacobian), landmarks.weights.shape[0]
    of_joints = landmarks.weights[:, V:] @ linear.joint_jacobian.reshape(K, 3 * Q)
    jacobian = np.asarray(of_joints).reshape(N, 3, Q)
    for group in slopes.groups:
        weights = landmarks.weights[:, group.points[: group.count]]
        if weights.nnz:
            part = weights @ group.slopes[: group.count].reshape(group.count, -1)
            jacobian[:, :, group.columns] += part.reshape(N, 3, -1)
    return jacobian
