"""Elbows and knees bend about one axis: the bone below stays in the plane across it.

The numbers of an axis-angle do not say so: a forearm that is bent and turned has all three. Limits on them
must be wide, and an upper arm, which looks alike from all sides, then turns about itself at will, the elbow
making up for it sideways.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from corporeal.geometry.rotations_numeric import left_jacobian, matrix_from_axis_angle, skew
from corporeal.model.jacobian import ParameterColumns
from corporeal.model.surface_model import SurfaceModel
from corporeal.solve.problem import PARAMETERS, Fields
from corporeal.terms.gaussian_prior import ParameterQuadratic

# The rest axes of the hinges of SMPL's family in its T-pose: an elbow bends forward, a knee backward.
_AXES = {"elbow": (0.0, 1.0, 0.0), "knee": (1.0, 0.0, 0.0)}
_SIDES = ("left", "right")
# Sine of the angle by which a forearm or shin may leave the plane in which it bends.
HINGE_SIGMA = 0.03


@dataclass(frozen=True, eq=False)
class Hinges:
    """Sine of the angle between the bone below a joint and the plane that its axis allows, in units of sigma.

    Attributes:
        name: of the term.
        columns: of the whole pose (3 K numbers, axis-angle).
        joints: (n,) the hinges.
        axes: (n, 3) of unit length, in the frame of the joint above.
        bones: (n, 3) of unit length at the zero pose, across the axes.
        sigma: standard deviation of the sine.
    """

    name: str
    columns: slice
    joints: Int[np.ndarray, " n"]
    axes: Float[np.ndarray, "n 3"]
    bones: Float[np.ndarray, "n 3"]
    sigma: float

    def at(self, fields: Fields) -> ParameterQuadratic:
        """Evaluate."""
        parameters = fields[PARAMETERS]
        pose = parameters[self.columns].reshape(-1, 3)
        turns = pose[self.joints]
        bones = np.einsum("nab,nb->na", matrix_from_axis_angle(turns), self.bones)
        off = np.einsum("na,na->n", self.axes, bones) / self.sigma
        # d (axis . R bone) = axis . (J d x R bone).
        slopes = np.einsum("na,nab,nbc->nc", self.axes, -skew(bones), left_jacobian(turns)) / self.sigma
        jacobian = np.zeros((len(off), *pose.shape))
        jacobian[np.arange(len(off)), self.joints] = slopes
        jacobian = jacobian.reshape(len(off), pose.size)
        return ParameterQuadratic(
            0.5 * float(off @ off), self.columns, jacobian.T @ off, jacobian.T @ jacobian, parameters.size
        )


def hinge_terms(model: SurfaceModel, columns: ParameterColumns, sigma: float) -> list[Hinges]:
    """The elbows and knees of a model that names its joints as SMPL does; nothing for any other."""
    rest = model.joint_regressor @ model.template
    joints, axes, bones = [], [], []
    for kind, axis in _AXES.items():
        for side in _SIDES:
            name = f"{side}_{kind}"
            if name not in model.joint_names:
                continue
            joint = model.joint_names.index(name)
            below = [k for k, parent in enumerate(model.parents) if parent == joint]
            if joint == 0 or len(below) != 1:
                continue
            bone = rest[below[0]] - rest[joint]
            bone = bone / np.linalg.norm(bone)
            across = np.array(axis) - (bone @ np.array(axis)) * bone
            joints.append(joint)
            axes.append(across / np.linalg.norm(across))
            bones.append(bone)
    if not joints:
        return []
    return [Hinges("hinges", columns.pose, np.array(joints), np.array(axes), np.array(bones), sigma)]
