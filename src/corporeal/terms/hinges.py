"""Elbows and knees bend about one axis and to one side: the bone below stays in the plane across it.

The numbers of an axis-angle do not say so: a forearm that is bent and turned has all three. Limits on them
must be wide, and an upper arm, which looks alike from all sides, then turns about itself at will, the elbow
making up for it sideways; turned by half a circle, it makes up for it by an elbow that bends backward.
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

# The rest axes about which hinges of SMPL's family bend in its T-pose: an elbow forward, a knee backward.
_AXES = {
    "left_elbow": (0.0, -1.0, 0.0),
    "right_elbow": (0.0, 1.0, 0.0),
    "left_knee": (1.0, 0.0, 0.0),
    "right_knee": (1.0, 0.0, 0.0),
}
# Sine of the angle by which a forearm or shin may leave the plane in which it bends.
HINGE_SIGMA = 0.03
# So far, in radians, a straight elbow or knee may be bent to the wrong side.
SLACK = np.deg2rad(8.0)


@dataclass(frozen=True, eq=False)
class Hinges:
    """How far the bone below a joint leaves the plane that its axis allows, and bends to the wrong side.

    Residuals are the sine of its angle to the plane, and the radians beyond ``SLACK`` to the wrong side.

    Attributes:
        name: of the term.
        columns: of the whole pose (3 K numbers, axis-angle).
        joints: (n,) the hinges.
        axes: (n, 3) of unit length, in the frame of the joint above; bending is a positive angle about them.
        bones: (n, 3) of unit length at the zero pose, across the axes.
        sigma: standard deviation of both.
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
        turns = parameters[self.columns].reshape(-1, 3)[self.joints]
        bones = np.einsum("nab,nb->na", matrix_from_axis_angle(turns), self.bones)
        forward = np.cross(self.axes, self.bones)
        along, ahead = np.einsum("na,na->n", self.bones, bones), np.einsum("na,na->n", forward, bones)
        excess = -np.arctan2(ahead, along) - SLACK
        # d (v . R bone) = v . (J d x R bone), for the axis and for what the angle grows along.
        growing = (along[:, None] * forward - ahead[:, None] * self.bones) / (along**2 + ahead**2)[:, None]
        directions = np.concatenate([self.axes, -np.where(excess[:, None] > 0, growing, 0.0)])
        off = np.concatenate([np.einsum("na,na->n", self.axes, bones), np.maximum(excess, 0.0)]) / self.sigma
        moved = np.einsum("nab,nbc->nac", -skew(bones), left_jacobian(turns))
        slopes = np.einsum("na,nac->nc", directions, np.tile(moved, (2, 1, 1))) / self.sigma
        size = self.columns.stop - self.columns.start
        jacobian = np.zeros((len(off), size // 3, 3))
        jacobian[np.arange(len(off)), np.tile(self.joints, 2)] = slopes
        jacobian = jacobian.reshape(len(off), size)
        return ParameterQuadratic(
            0.5 * float(off @ off), self.columns, jacobian.T @ off, jacobian.T @ jacobian, parameters.size
        )


def hinge_terms(model: SurfaceModel, columns: ParameterColumns, sigma: float) -> list[Hinges]:
    """The elbows and knees of a model that names its joints as SMPL does; nothing for any other."""
    rest = model.joint_regressor @ model.template
    joints, axes, bones = [], [], []
    for name, axis in _AXES.items():
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
