"""An arm that was missing and has come back elsewhere, looked for where the scan has points left over."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from corporeal.geometry.rotations_numeric import axis_angle_from_matrix, matrix_from_axis_angle
from corporeal.model.surface_model import SurfaceModel
from corporeal.terms.hinges import Hinges
from corporeal.terms.model_fields import ModelFields
from corporeal.terms.scan_to_surface import MovingSurface

# Turns of the upper arm about itself, to either side of where it was, and bends of the elbow, degrees.
_TURNS, _BENDS = np.arange(-100, 101, 20), (0, 20, 45, 70, 95, 120)
# A point farther than this from an arm speaks against it no more, metres.
_FARTHEST = 0.15


@dataclass(frozen=True, eq=False)
class ArmSearch:
    """All poses of one arm below a shoulder that is seen.

    Attributes:
        shoulder: joint whose turn about the upper arm is not known.
        elbow: joint whose bend is not known; what it turns the forearm by stays.
        upper_arm: (3,) direction of the bone at the zero pose.
        axis: (3,) about which the elbow bends, in the frame of the joint above.
        forearm: (3,) direction of the bone at the zero pose, across the axis.
    """

    shoulder: int
    elbow: int
    upper_arm: Float[np.ndarray, "3"]
    axis: Float[np.ndarray, "3"]
    forearm: Float[np.ndarray, "3"]

    @classmethod
    def below(cls, model: SurfaceModel, elbow: int, hinges: Hinges) -> ArmSearch | None:
        """That of an elbow; None where it is not among the hinges."""
        places = np.flatnonzero(hinges.joints == elbow)
        if not len(places):
            return None
        shoulder, place = int(model.parents[elbow]), int(places[0])
        rest = model.joint_regressor @ model.template
        bone = rest[elbow] - rest[shoulder]
        return cls(shoulder, elbow, bone / np.linalg.norm(bone), hinges.axes[place], hinges.bones[place])

    def nearest(
        self,
        fields: ModelFields,
        surface: MovingSurface,
        vector: Float[np.ndarray, " Q"],
        points: Float[np.ndarray, "n 3"],
    ) -> Float[np.ndarray, " Q"]:
        """The parameters with the arm in the pose that lies nearest to points; all else stays.

        Args:
            fields: of the model.
            surface: of the model.
            vector: parameters that fit what else is seen.
            points: metres, that no part of the model explains yet.
        """
        best, least = vector, self._distance(fields, surface, vector, points)
        for turn, bend in itertools.product(np.deg2rad(_TURNS), np.deg2rad(_BENDS)):
            posed = vector.copy()
            pose = posed[fields.columns.pose].reshape(-1, 3)
            pose[[self.shoulder, self.elbow]] = self._turned(pose, float(turn), float(bend))
            distance = self._distance(fields, surface, posed, points)
            if distance < least:
                best, least = posed, distance
        return best

    def _turned(self, pose: Float[np.ndarray, "K 3"], turn: float, bend: float) -> Float[np.ndarray, "2 3"]:
        """Axis-angles of shoulder and elbow with the one turned further and the other bent so far."""
        upper, lower = matrix_from_axis_angle(pose[[self.shoulder, self.elbow]])
        now = lower @ self.forearm
        angle = np.arctan2(now @ np.cross(self.axis, self.forearm), now @ self.forearm)
        turned, bent, unbent = matrix_from_axis_angle(
            np.array([turn * self.upper_arm, bend * self.axis, -angle * self.axis])
        )
        return axis_angle_from_matrix(np.array([upper @ turned, bent @ unbent @ lower]))

    @staticmethod
    def _distance(
        fields: ModelFields, surface: MovingSurface, vector: np.ndarray, points: np.ndarray
    ) -> float:
        vertices = fields.evaluated(vector).vertices
        return float(np.minimum(surface.closest(vertices, points, None).distances, _FARTHEST).mean())
