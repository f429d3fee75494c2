"""Closed-form Jacobian of one posed surface, for solvers: float64 numpy in and out.

The derivative of a vertex by a joint's rotation is the cross product with the part of the vertex that the joint's
descendants carry, plus the derivative of the pose correctives; rotations are differentiated through the left
Jacobian of SO(3) (Sola et al. 2018, "A micro Lie theory", equation 145), which is smooth at every angle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from corporeal.model import jacobian_kernels as kernels
from corporeal.model.kernel_arrays import KernelArrays
from corporeal.model.surface_model import SurfaceModel

# Work below which a second thread costs more than it saves, in multiply-adds; waking it takes about 10 us.
_PARALLEL_FROM = 100_000
_CHUNKS = 16


@dataclass(frozen=True)
class ParameterColumns:
    """Which columns of a Jacobian belong to which parameters.

    Attributes:
        translation: 3 columns.
        pose: 3 K columns, axis-angle of every joint, the root first.
        shape: as many columns as shape coefficients were given.
        expression: the same for expression coefficients.
    """

    translation: slice
    pose: slice
    shape: slice
    expression: slice

    @classmethod
    def of_counts(cls, joints: int, shape: int, expression: int) -> ParameterColumns:
        """Columns in their one order: translation, pose, shape, expression."""
        ends = np.cumsum([3, 3 * joints, shape, expression]).tolist()
        starts = [0, *ends[:-1]]
        return cls(*(slice(start, end) for start, end in zip(starts, ends, strict=True)))

    @property
    def count(self) -> int:
        """Q, the number of columns."""
        return int(self.expression.stop)


@dataclass(frozen=True, eq=False)
class Evaluated:
    """One posed surface in metres: vertices (V, 3), joints (K, 3), T_world_joint (K, 4, 4)."""

    vertices: Float[np.ndarray, "V 3"]
    joints: Float[np.ndarray, "K 3"]
    T_world_joint: Float[np.ndarray, "K 4 4"]


@dataclass(frozen=True, eq=False)
class Linearised:
    """One posed surface and its derivatives, in metres and radians.

    Attributes:
        vertices: (V, 3).
        joints: (K, 3).
        T_world_joint: (K, 4, 4).
        vertex_jacobian: (V, 3, Q), C-contiguous: ``reshape(3 * V, Q)`` copies nothing.
        joint_jacobian: (K, 3, Q).
        columns: which columns belong to which parameters.
    """

    vertices: Float[np.ndarray, "V 3"]
    joints: Float[np.ndarray, "K 3"]
    T_world_joint: Float[np.ndarray, "K 4 4"]
    vertex_jacobian: Float[np.ndarray, "V 3 Q"]
    joint_jacobian: Float[np.ndarray, "K 3 Q"]
    columns: ParameterColumns


@dataclass(frozen=True, eq=False)
class _State:
    """Checked parameters and the posed joints; what both functions below share."""

    arrays: KernelArrays
    coefficients: Float[np.ndarray, " C"]
    ranges: Int[np.ndarray, "2 2"]
    feature: Float[np.ndarray, " P"]
    local: Float[np.ndarray, "K 3 3"]
    left: Float[np.ndarray, "K 3 3"]
    turned: Float[np.ndarray, "K 3 3"]
    placed: Float[np.ndarray, "K 3"]
    offset: Float[np.ndarray, "K 3"]
    translation: Float[np.ndarray, 3]

    def vertex_inputs(self) -> tuple[np.ndarray, ...]:
        """What both vertex kernels take first, in their order."""
        arrays = self.arrays
        return (
            arrays.template, arrays.directions, self.coefficients, self.ranges, arrays.pose_directions,
            self.feature, arrays.corrected.starts, arrays.corrected.columns, arrays.weights.starts,
            arrays.weights.columns, arrays.weights.values,
        )  # fmt: skip

    def frames(self) -> tuple[np.ndarray, np.ndarray]:
        """Joints (K, 3) and T_world_joint (K, 4, 4), translation included."""
        joints = self.placed + self.translation
        T_world_joint = np.zeros((len(joints), 4, 4))
        T_world_joint[:, :3, :3] = self.turned
        T_world_joint[:, :3, 3] = joints
        T_world_joint[:, 3, 3] = 1
        return joints, T_world_joint


def evaluate(
    model: SurfaceModel,
    shape: Float[np.ndarray, " s"],
    pose: Float[np.ndarray, "K 3"],
    translation: Float[np.ndarray, 3],
    expression: Float[np.ndarray, " e"] | None = None,
    *,
    correctives: bool = True,
) -> Evaluated:
    """Pose one surface, without derivatives.

    Args:
        model: the model.
        shape: coefficients of the first s shape directions.
        pose: axis-angle of every joint in radians, the root first; no mean is added.
        translation: added after posing, metres.
        expression: coefficients of the first e expression directions, or None.
        correctives: False leaves the pose correctives out.

    Raises:
        ValueError: a wrong number of joints, or more coefficients than directions.
    """
    state = _posed_joints(model, shape, pose, translation, expression, correctives)
    vertices = np.empty_like(state.arrays.template)
    work = 3 * len(vertices) * (int(state.ranges[:, 1].sum()) + len(state.feature) + 40)
    kernels.pose_vertices(
        _chunks(work), *state.vertex_inputs(), state.turned, state.offset, state.translation, vertices
    )
    return Evaluated(vertices, *state.frames())


def linearise(
    model: SurfaceModel,
    shape: Float[np.ndarray, " s"],
    pose: Float[np.ndarray, "K 3"],
    translation: Float[np.ndarray, 3],
    expression: Float[np.ndarray, " e"] | None = None,
    *,
    correctives: bool = True,
) -> Linearised:
    """Pose one surface and differentiate it by all its parameters; arguments as for ``evaluate``.

    The columns of the pose are derivatives by the axis-angle numbers themselves.

    Raises:
        ValueError: a wrong number of joints, or more coefficients than directions.
    """
    state = _posed_joints(model, shape, pose, translation, expression, correctives)
    arrays = state.arrays
    V, K = len(arrays.template), len(arrays.parents)
    coefficient_count = int(state.ranges[:, 1].sum())
    columns = ParameterColumns.of_counts(K, int(state.ranges[0, 1]), int(state.ranges[1, 1]))
    spin, turning, shift = np.empty((K, 3, 3)), np.empty((K, 9, 3)), np.empty((K, 3, coefficient_count))
    joint_jacobian = np.zeros((K, 3, columns.count))
    kernels.joint_derivatives(
        arrays.parents, state.local, state.left, state.turned, state.placed, arrays.joint_directions,
        state.ranges, spin, turning, shift, joint_jacobian,
    )  # fmt: skip
    vertices, jacobian = np.empty((V, 3)), np.empty((V, 3, columns.count))
    work = 3 * V * (columns.count + coefficient_count + 4 * len(state.feature))
    kernels.vertex_derivatives(
        _chunks(work), *state.vertex_inputs(), arrays.chain.starts, arrays.chain.columns, arrays.parents,
        state.turned, state.placed, state.offset, spin, turning, shift, state.translation, vertices, jacobian,
    )  # fmt: skip
    joints, T_world_joint = state.frames()
    return Linearised(vertices, joints, T_world_joint, jacobian, joint_jacobian, columns)


def _chunks(work: int) -> int:
    return _CHUNKS if work > _PARALLEL_FROM else 1


def _posed_joints(
    model: SurfaceModel, shape: np.ndarray, pose: np.ndarray, translation: np.ndarray,
    expression: np.ndarray | None, correctives: bool,
) -> _State:  # fmt: skip
    arrays = model.kernel_arrays
    K = len(arrays.parents)
    if pose.shape != (K, 3):
        raise ValueError(
            f"pose: shape {pose.shape}, expected ({K}, 3): one axis-angle per joint of the model"
        )
    coefficients, ranges = _coefficients(model, shape, expression)
    pose = np.ascontiguousarray(pose, dtype=np.float64)
    local, left, turned = np.empty((K, 3, 3)), np.empty((K, 3, 3)), np.empty((K, 3, 3))
    rest_joints, placed, offset = np.empty((K, 3)), np.empty((K, 3)), np.empty((K, 3))
    kernels.rest_joint_positions(
        arrays.joint_template, arrays.joint_directions, coefficients, ranges, rest_joints
    )
    kernels.joint_motion(pose, rest_joints, arrays.parents, local, left, turned, placed, offset)
    feature = np.empty(arrays.pose_directions.shape[2] if correctives else 0)
    if len(feature):
        kernels.pose_feature(local, feature)
    return _State(
        arrays, coefficients, ranges, feature, local, left, turned, placed, offset,
        np.ascontiguousarray(translation, dtype=np.float64),
    )  # fmt: skip


def _coefficients(
    model: SurfaceModel, shape: np.ndarray, expression: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """All C coefficients, and (first, count) of the given shape and expression coefficients among them."""
    S, E = model.shape_count, model.expression_count
    expression = np.zeros(0) if expression is None else expression
    for label, given, count in (("shape", shape, S), ("expression", expression, E)):
        if len(given) > count:
            raise ValueError(f"{label}: {len(given)} coefficients for {count} {label} directions")
    coefficients = np.zeros(S + E)
    coefficients[: len(shape)] = shape
    coefficients[S : S + len(expression)] = expression
    return coefficients, np.array([[0, len(shape)], [S, len(expression)]])
