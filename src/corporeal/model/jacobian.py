"""Closed-form Jacobian of one posed surface, for solvers: float64 numpy in and out.

The derivative of a vertex by a joint's rotation is the cross product with the part of the vertex that the
joint's descendants carry, plus the derivative of the pose correctives. Rotations are differentiated through
the left Jacobian of SO(3) (Sola et al. 2018, "A micro Lie theory", equation 145), smooth at every angle.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from corporeal.model import jacobian_kernels as kernels
from corporeal.model.kernel_arrays import KernelArrays
from corporeal.model.surface_model import SurfaceModel
from corporeal.model.vertex_groups import VertexGroup

# Multiply-adds below which a second thread costs more than it saves: a thread pool that sleeps while it waits
# (OMP_WAIT_POLICY) takes about 80 us to wake.
_PARALLEL_FROM = 2_000_000
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


class JointState(NamedTuple):
    """The posed joints, without translation: what both functions below start from."""

    local: Float[np.ndarray, "K 3 3"]  # rotation against the parent
    left: Float[np.ndarray, "K 3 3"]  # left Jacobian of SO(3) at the joint's axis-angle
    turned: Float[np.ndarray, "K 3 3"]  # rotation to the world
    rest: Float[np.ndarray, "K 3"]  # position at the zero pose
    placed: Float[np.ndarray, "K 3"]  # position
    motion: Float[np.ndarray, "K 12"]  # what skinning blends: rotation row-major, then placed - turned @ rest
    feature: Float[np.ndarray, "k 9"]  # rotations minus identity, not the root's; empty without correctives

    @classmethod
    def blank(cls, K: int, corrected: int) -> JointState:
        """Room for K joints and the pose features of so many."""
        local, left, turned = np.empty((3, K, 3, 3))
        rest, placed = np.empty((2, K, 3))
        return cls(local, left, turned, rest, placed, np.empty((K, 12)), np.empty((corrected, 9)))

    def frames(self, translation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Joints (K, 3) and T_world_joint (K, 4, 4)."""
        joints = self.placed + translation
        T_world_joint = np.zeros((len(joints), 4, 4))
        T_world_joint[:, :3, :3] = self.turned
        T_world_joint[:, :3, 3] = joints
        T_world_joint[:, 3, 3] = 1
        return joints, T_world_joint


@dataclass(frozen=True, eq=False)
class GroupedLinearised:
    """The derivatives of one posed surface, without most of their zeros.

    Attributes:
        joint_jacobian: (K, 3, Q).
        group_columns: per group of ``model.vertex_groups`` the (a,) columns that its vertices depend on.
        group_jacobians: per group (m, 3, a), for the vertices of ``around``.
    """

    joint_jacobian: Float[np.ndarray, "K 3 Q"]
    group_columns: tuple[Int[np.ndarray, " _"], ...]
    group_jacobians: tuple[Float[np.ndarray, "_ 3 _"], ...]


class Chosen(NamedTuple):
    """Whose derivatives are wanted, by what, and where they go."""

    vertices: Int[np.ndarray, " m"]
    layout: Int[np.ndarray, " K"]  # first column of every joint; of no account for those that move none
    directions: Int[np.ndarray, " n"]  # of shape and expression; theirs are the last columns


class JointSlopes(NamedTuple):
    """The part of the Jacobian that depends on joints alone."""

    spin: Float[np.ndarray, "K 3 3"]  # axis-angle of a joint -> world rotation of its subtree
    turning: Float[np.ndarray, "K 9 3"]  # derivative of the rotation matrix by the axis-angle
    shift: Float[np.ndarray, "K 3 n"]  # derivative of the motion's offset by the coefficients


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
    coefficients, _ = _coefficients(model, shape, expression)
    return _evaluated(model.kernel_arrays, coefficients, pose, translation, correctives)


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
    terms = _Linearisation.of_model(model, shape, pose, expression, correctives)
    translation = np.ascontiguousarray(translation, dtype=np.float64)
    jacobian = terms.of_all_vertices()
    vertices = _posed_vertices(model.kernel_arrays, terms.coefficients, terms.joints, translation)
    frames = terms.joints.frames(translation)
    return Linearised(vertices, *frames, jacobian, terms.joint_jacobian, terms.columns)


def linearise_groups(
    model: SurfaceModel,
    shape: Float[np.ndarray, " s"],
    pose: Float[np.ndarray, "K 3"],
    expression: Float[np.ndarray, " e"] | None = None,
    *,
    correctives: bool = True,
) -> GroupedLinearised:
    """The same derivatives by groups of vertices, each with the columns that it depends on.

    Raises:
        ValueError: a wrong number of joints, or more coefficients than directions.
    """
    terms = _Linearisation.of_model(model, shape, pose, expression, correctives)
    columns, jacobians = [], []
    for group in model.vertex_groups:
        own = _columns_of(group, terms.columns)
        layout = np.zeros(model.joint_count, dtype=np.int64)
        layout[group.joints] = 3 + 3 * np.arange(len(group.joints))
        columns.append(own)
        jacobians.append(terms.of_vertices(group.around, layout, len(own)))
    return GroupedLinearised(terms.joint_jacobian, tuple(columns), tuple(jacobians))


class SomeVertices:
    """A few vertices of a model, posed without the others: landmarks lie on a tenth of a hand's."""

    def __init__(self, model: SurfaceModel, vertices: Int[np.ndarray, " n"]) -> None:
        """Take them, in the order given, out of a model."""
        self._model = model
        self._arrays = model.kernel_arrays.of_vertices(vertices)

    def evaluate(
        self, shape: Float[np.ndarray, " s"], pose: Float[np.ndarray, "K 3"],
        translation: Float[np.ndarray, 3], *, correctives: bool = True,
    ) -> Evaluated:  # fmt: skip
        """These vertices (n, 3) and all joints; arguments and errors as of ``evaluate``."""
        coefficients, _ = _coefficients(self._model, shape, None)
        return _evaluated(self._arrays, coefficients, pose, translation, correctives)

    def linearise(
        self, shape: Float[np.ndarray, " s"], pose: Float[np.ndarray, "K 3"], *, correctives: bool = True
    ) -> tuple[Float[np.ndarray, "n 3 Q"], Float[np.ndarray, "K 3 Q"]]:
        """Derivatives of these vertices, and of all joints, by all parameters."""
        coefficients, chosen = _coefficients(self._model, shape, None)
        terms = _Linearisation(self._arrays, coefficients, chosen, len(shape), pose, correctives)
        return terms.of_all_vertices(), terms.joint_jacobian


class _Linearisation:
    """Joints and their slopes at one pose: what the derivatives of any vertices follow from."""

    def __init__(
        self, arrays: KernelArrays, coefficients: np.ndarray, chosen: np.ndarray, shape_count: int,
        pose: np.ndarray, correctives: bool,
    ) -> None:  # fmt: skip
        self._arrays, self.coefficients, self._chosen = arrays, coefficients, chosen
        self.joints = _posed_joints(arrays, coefficients, pose, correctives)
        K, n = len(arrays.parents), len(chosen)
        self.columns = ParameterColumns.of_counts(K, shape_count, n - shape_count)
        self._slopes = JointSlopes(np.empty((K, 3, 3)), np.empty((K, 9, 3)), np.empty((K, 3, n)))
        self.joint_jacobian = np.zeros((K, 3, self.columns.count))
        directions = arrays.joint_directions[:, :, self._chosen]
        kernels.joint_slopes(arrays, self.joints, directions, self._slopes, self.joint_jacobian)

    @classmethod
    def of_model(
        cls, model: SurfaceModel, shape: np.ndarray, pose: np.ndarray, expression: np.ndarray | None,
        correctives: bool,
    ) -> _Linearisation:  # fmt: skip
        coefficients, chosen = _coefficients(model, shape, expression)
        return cls(model.kernel_arrays, coefficients, chosen, len(shape), pose, correctives)

    def of_all_vertices(self) -> Float[np.ndarray, "V 3 Q"]:
        """Derivatives of all vertices of the arrays, by all parameters."""
        V, K = len(self._arrays.weight_starts) - 1, len(self._arrays.parents)
        return self.of_vertices(np.arange(V), 3 + 3 * np.arange(K), self.columns.count)

    def of_vertices(
        self, vertices: Int[np.ndarray, " m"], layout: Int[np.ndarray, " K"], width: int
    ) -> Float[np.ndarray, "m 3 a"]:
        """Derivatives of some vertices, ``width`` columns each."""
        jacobian = np.empty((len(vertices), 3, width))
        chosen = Chosen(vertices, layout, self._chosen)
        corrected = self._arrays.correctives.size // (len(self._arrays.corrected_starts) - 1)
        work = len(jacobian) * (3 * width + 9 * len(self._chosen) + 4 * corrected)
        kernels.linearise_vertices(
            _chunks(work), self._arrays, chosen, self.coefficients, self.joints, self._slopes, jacobian
        )  # fmt: skip
        return jacobian


def _columns_of(group: VertexGroup, columns: ParameterColumns) -> Int[np.ndarray, " a"]:
    """Translation, the group's joints, shape and expression."""
    joints = columns.pose.start + 3 * np.repeat(group.joints, 3) + np.tile(np.arange(3), len(group.joints))
    return np.concatenate([np.arange(3), joints, np.arange(columns.shape.start, columns.count)])


def _chunks(work: int) -> int:
    return _CHUNKS if work > _PARALLEL_FROM else 1


def _evaluated(
    arrays: KernelArrays, coefficients: np.ndarray, pose: np.ndarray, translation: np.ndarray,
    correctives: bool,
) -> Evaluated:  # fmt: skip
    joints = _posed_joints(arrays, coefficients, pose, correctives)
    translation = np.ascontiguousarray(translation, dtype=np.float64)
    return Evaluated(_posed_vertices(arrays, coefficients, joints, translation), *joints.frames(translation))


def _posed_vertices(
    arrays: KernelArrays, coefficients: np.ndarray, joints: JointState, translation: np.ndarray
) -> np.ndarray:
    vertices = np.empty((len(arrays.weight_starts) - 1, 3))
    work = vertices.size * (len(coefficients) + 40)
    work += arrays.correctives.size if len(joints.feature) else 0
    kernels.pose_vertices(_chunks(work), arrays, coefficients, joints, translation, vertices)
    return vertices


def _posed_joints(
    arrays: KernelArrays, coefficients: np.ndarray, pose: np.ndarray, correctives: bool
) -> JointState:
    K = len(arrays.parents)
    if pose.shape != (K, 3):
        raise ValueError(
            f"pose: shape {pose.shape}, expected ({K}, 3): one axis-angle per joint of the model"
        )
    joints = JointState.blank(K, K - 1 if correctives and arrays.correctives.size else 0)
    pose = np.ascontiguousarray(pose, dtype=np.float64)
    kernels.chain_joints(arrays, coefficients, pose, joints)
    return joints


def _coefficients(
    model: SurfaceModel, shape: np.ndarray, expression: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """All C coefficients, and the indices of those that were given."""
    S, E = model.shape_count, model.expression_count
    expression = np.zeros(0) if expression is None else expression
    for label, given, count in (("shape", shape, S), ("expression", expression, E)):
        if len(given) > count:
            raise ValueError(f"{label}: {len(given)} coefficients for {count} {label} directions")
    coefficients = np.zeros(S + E)
    chosen = np.concatenate([np.arange(len(shape)), S + np.arange(len(expression))])
    coefficients[chosen] = np.concatenate([shape, expression])
    return coefficients, chosen
