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
# Of the distance that the points have before, the most that a pose may leave to be worth trying.
_LEFT = 0.8
# So many poses are worth trying, which differ by more than so many degrees of turn and bend together.
_TRIED, _APART = 3, 45


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
    ) -> list[Float[np.ndarray, " Q"]]:
        """The parameters with the arm in the poses that lie nearest to points, the nearest first.

        Several, since the nearest may be one from which no descent leads on; none where none is much nearer.

        Args:
            fields: of the model.
            surface: of the model.
            vector: parameters that fit what else is seen; all but the arm's stay.
            points: metres, that no part of the model explains yet.
        """
        bound = _LEFT * self._distance(fields, surface, vector, points)
        candidates = []
        for turn, bend in itertools.product(_TURNS, _BENDS):
            posed = vector.copy()
            pose = posed[fields.columns.pose].reshape(-1, 3)
            pose[[self.shoulder, self.elbow]] = self._turned(pose, np.deg2rad(turn), np.deg2rad(bend))
            distance = self._distance(fields, surface, posed, points)
            if distance < bound:
                candidates.append((distance, turn, bend, posed))
        kept: list[tuple] = []
        for one in sorted(candidates, key=lambda candidate: candidate[0]):
            apart = [abs(one[1] - other[1]) + abs(one[2] - other[2]) for other in kept]
            if len(kept) < _TRIED and all(degrees > _APART for degrees in apart):
                kept.append(one)
        return [posed for *_, posed in kept]

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
