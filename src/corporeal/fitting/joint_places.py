"""Where a model's joints belong, told by scans: surfaces laid onto these cannot tell it afterwards.

Where a joint of a model lies elsewhere in its skin than a person's, whatever may slide does so until the
joint turns where the person's does, in every scan alike: the free vertices of a registration, so that a model
learned from them keeps the joint where it was, and the shape of a tracked body. The rigged surface cannot:
it misses scans of bent joints instead. Here all poses, the shapes and one shift per joint, common to all
subjects, are solved for together, so that it misses them least. Joints of a body that is its own mirror image
stay each other's mirror images.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int

from corporeal.geometry.closest_points import SurfaceTree
from corporeal.geometry.normals import vertex_normals
from corporeal.model.jacobian import Linearised, linearise
from corporeal.model.joint_regressor import fit_regressor, joints_below, with_regressor
from corporeal.model.surface_model import SurfaceModel

_FEWEST_POINTS = 100
# Shapes by which the regressor is told how joints go with the surface.
_DRAWN_SHAPES = 40
# What holds a scan's translation, root and joints to where they are in one step, square metres.
_STILL = (1e-9, 1e-9, 4e-6)
# Square metres that one standard deviation of shape costs a subject.
_SHAPE_COST = 1e-6
# Radians: longer steps of an angle are cut to this.
_LONGEST_TURN = 0.3


class JointPlaceError(ValueError):
    """Joints cannot be placed by these scans; the message says why."""


@dataclass(frozen=True)
class JointPlaceOptions:
    """How joints are placed.

    Attributes:
        strength: what a joint's shift costs, in points of every scan that are off by as much. With 0.02
            joints wander along the axes about which alone they turn; from 0.05 to 0.2 the joints of simulated
            people are found alike.
        reach: points farther from the surface are left out, metres.
        robust_distance: from here on a point counts less, metres.
        steps: most Gauss-Newton steps.
        settled: a step that moves no joint by more is the last, metres.
        fixed: names of joints that stay, as the root does.
    """

    strength: float = 0.1
    reach: float = 6e-3
    robust_distance: float = 2e-3
    steps: int = 12
    settled: float = 1e-4
    fixed: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class PosedScan:
    """Points of a scan and where the model stands in it.

    Attributes:
        name: of the scan.
        subject: whose surface it is: one shape each.
        points: (N, 3) metres.
        pose: (K, 3) axis-angle, radians, where the search begins.
        shape: (S,) the same.
        translation: (3,) metres, the same.
    """

    name: str
    subject: str
    points: Float[np.ndarray, "N 3"]
    pose: Float[np.ndarray, "K 3"]
    shape: Float[np.ndarray, " S"]
    translation: Float[np.ndarray, "3"]


@dataclass(frozen=True, eq=False)
class PlacedJoints:
    """A model with its joints moved.

    Attributes:
        model: the model; its regressor alone differs.
        shifts: (K, 3) of the joints of the template, metres; zero for the root.
        rms_mm: of the points from the surface along its normals, before every step, robustly weighed.
    """

    model: SurfaceModel
    shifts: Float[np.ndarray, "K 3"]
    rms_mm: tuple[float, ...]


class _Surface(NamedTuple):
    """What is made once: the tree of the surface, and what every joint carries of it."""

    tree: SurfaceTree
    carried: Float[np.ndarray, "V K"]


class _Equations(NamedTuple):
    """Normal equations of one scan: its own unknowns (translation, pose), and those it shares."""

    own: Float[np.ndarray, "q q"]
    mixed: Float[np.ndarray, "q m"]
    shared: Float[np.ndarray, "m m"]
    own_pull: Float[np.ndarray, " q"]
    shared_pull: Float[np.ndarray, " m"]
    squares: float
    weight: float


def place_joints(
    model: SurfaceModel,
    scans: Sequence[PosedScan],
    options: JointPlaceOptions | None = None,
    on_step: Callable[[int, float], None] | None = None,
) -> PlacedJoints:
    """Move the joints of a model to where its posed surfaces, without free vertices, miss scans least.

    Args:
        model: whose joints are in question; it knows shapes and pose correctives well enough to lie within
            millimetres of the scans.
        scans: in bent poses, with poses and shapes that fit roughly.
        options: how.
        on_step: told after every step its number and the rms in millimetres before it.

    Raises:
        JointPlaceError: as ``joint_shifts``.
    """
    shifts, rms = joint_shifts(model, scans, options, on_step)
    return PlacedJoints(_regressed(model, shifts), shifts, rms)


def joint_shifts(
    model: SurfaceModel,
    scans: Sequence[PosedScan],
    options: JointPlaceOptions | None = None,
    on_step: Callable[[int, float], None] | None = None,
) -> tuple[Float[np.ndarray, "K 3"], tuple[float, ...]]:
    """How far the joints of a model's template belong elsewhere, metres, and the rms before every step, mm.

    The root stays: where it lies nothing in a scan of the model's own parts tells. Arguments are those of
    ``place_joints``.

    Raises:
        JointPlaceError: no scan, a shape or pose that does not fit the model, or a scan that the posed model
            does not lie on; the message names it.
    """
    options = options or JointPlaceOptions()
    _check(model, scans)
    scans, shifts, rms = _of_one_shape(scans), np.zeros((model.joint_count, 3)), []
    surface = _Surface(SurfaceTree(model.template, model.faces), carried_by(model))
    free = _free_shifts(model, options.fixed)
    for step in range(options.steps):
        moved = with_shifted_joints(model, shifts)
        found = [_equations(moved, surface, scan, options) for scan in scans]
        rms.append(1e3 * float(np.sqrt(sum(e.squares for e in found) / sum(e.weight for e in found))))
        scans, change = _stepped(scans, found, shifts, free, options.strength)
        shifts = shifts + change
        if on_step is not None:
            on_step(step + 1, rms[-1])
        if np.linalg.norm(change, axis=1).max() < options.settled:
            break
    return shifts, tuple(rms)


def with_shifted_joints(model: SurfaceModel, shifts: Float[np.ndarray, "K 3"]) -> SurfaceModel:
    """The model with the joints of its template moved; shapes stretch the shifts as they stretch the whole.

    Rows of the regressor then bear on every vertex and may be negative: for use, not for a file.

    Args:
        model: the model.
        shifts: metres.
    """
    affine = np.vstack([model.template.T, np.ones(model.vertex_count)])
    wanted = np.vstack([shifts.T, np.zeros(len(shifts))])
    rows = (affine.T @ np.linalg.solve(affine @ affine.T, wanted)).T
    return with_regressor(model, sp.csr_matrix(model.joint_regressor.toarray() + rows))


def carried_by(model: SurfaceModel) -> Float[np.ndarray, "V K"]:
    """How much of every vertex goes along with every joint: its weights on the joint and all below."""
    return np.asarray(model.skinning_weights @ joints_below(model.parents))


def shift_slopes(
    posed: Linearised, parents: Int[np.ndarray, " K"], carried: Float[np.ndarray, "n K"],
    directions: Float[np.ndarray, "n 3"],
) -> Float[np.ndarray, "n K 3"]:  # fmt: skip
    """How far points of a posed surface go along directions, by the place of every joint of the unposed one.

    What lies below a joint k is carried by its shift turned by R_parent - R_k, in world rotations; the root's
    is zero.
    """
    R = posed.T_world_joint[:, :3, :3]
    turns = R[parents] - R
    turns[0] = 0
    return carried[:, :, None] * np.einsum("na,kab->nkb", directions, turns)


def _free_shifts(model: SurfaceModel, fixed: Sequence[str]) -> Float[np.ndarray, "m n"]:
    """Orthonormal shifts of all joints that may move; of a body that is its own mirror image, even ones."""
    mirror = np.arange(model.joint_count) if model.mirror_joints is None else model.mirror_joints
    shifts = []
    for joint, other in enumerate(mirror):
        if joint == 0 or other < joint or model.joint_names[joint] in fixed:
            continue
        for axis in range(3):
            shift = np.zeros((model.joint_count, 3))
            shift[other, axis] += 1.0 if axis or model.mirror_joints is None else -1.0
            shift[joint, axis] += 1.0
            if shift.any():
                shifts.append(shift.ravel() / np.linalg.norm(shift))
    return np.array(shifts)


def _check(model: SurfaceModel, scans: Sequence[PosedScan]) -> None:
    if not scans:
        raise JointPlaceError("scans: none was given; joints are placed by scans of bent ones")
    for scan in scans:
        if scan.pose.shape != (model.joint_count, 3) or not 0 < len(scan.shape) <= model.shape_count:
            raise JointPlaceError(
                f"{scan.name}: {len(scan.pose)} joints and {len(scan.shape)} shape numbers, but "
                f"{model.name!r} has {model.joint_count} and {model.shape_count}; give the model that it was "
                "registered with"
            )


def _of_one_shape(scans: Sequence[PosedScan]) -> list[PosedScan]:
    """The scans with the mean shape of their subject."""
    shapes = {
        subject: np.mean([scan.shape for scan in scans if scan.subject == subject], axis=0)
        for subject in {scan.subject for scan in scans}
    }
    return [replace(scan, shape=shapes[scan.subject]) for scan in scans]


def _equations(
    model: SurfaceModel, surface: _Surface, scan: PosedScan, options: JointPlaceOptions
) -> _Equations:
    """Point-to-plane distances of a scan's points, linearised; the tree is moved to the posed surface."""
    posed = linearise(model, scan.shape, scan.pose, scan.translation)
    surface.tree.refit(posed.vertices)
    closest = surface.tree.closest(scan.points)
    corners = model.faces[closest.faces]
    kept = closest.distances < options.reach
    if model.cut is not None:
        at_rest = np.einsum("pi,pia->pa", closest.barycentric, model.template[corners])
        plane = np.asarray(model.joint_regressor[model.cut.joint] @ model.template) + model.cut.point
        kept &= (at_rest - plane) @ model.cut.normal > 0
    if kept.sum() < _FEWEST_POINTS:
        raise JointPlaceError(
            f"{scan.name}: {kept.sum()} of its points are within {1e3 * options.reach:g} mm of the posed "
            f"model, {_FEWEST_POINTS} are needed; leave it out, or register it again"
        )
    corners, shares = corners[kept], closest.barycentric[kept]
    # Of vertices, not of faces: nearest to an edge, rounding would decide between two.
    normals = np.einsum("pi,pia->pa", shares, vertex_normals(posed.vertices, model.faces)[corners])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    off = np.einsum("pa,pa->p", normals, scan.points[kept] - closest.points[kept])
    by_model = np.einsum("pi,piaq,pa->pq", shares, posed.vertex_jacobian[corners], normals, optimize=True)
    carried = np.einsum("pi,pik->pk", shares, surface.carried[corners])
    by_shifts = shift_slopes(posed, model.parents, carried, normals)
    own, columns = 3 + scan.pose.size, posed.columns
    common = np.concatenate([by_model[:, columns.shape], by_shifts.reshape(len(off), -1)], axis=1)
    weights = options.robust_distance**2 / (options.robust_distance**2 + off**2)
    weighed, shared = weights[:, None] * by_model[:, :own], weights[:, None] * common
    return _Equations(
        own=weighed.T @ by_model[:, :own], mixed=weighed.T @ common, shared=shared.T @ common,
        own_pull=weighed.T @ off, shared_pull=shared.T @ off,
        squares=float(weights @ off**2), weight=float(weights.sum()),
    )  # fmt: skip


def _stepped(
    scans: Sequence[PosedScan], found: Sequence[_Equations], shifts: Float[np.ndarray, "K 3"],
    free: Float[np.ndarray, "m n"], strength: float,
) -> tuple[list[PosedScan], Float[np.ndarray, "K 3"]]:  # fmt: skip
    """One Gauss-Newton step: every scan's own unknowns are eliminated, then every subject's shape."""
    numbers, joints = len(scans[0].shape), scans[0].pose.size
    still = np.repeat(_STILL, [3, 3, joints - 3])
    solved = [np.linalg.solve(e.own + np.diag(still), np.column_stack([e.mixed, e.own_pull])) for e in found]
    price = strength * len(scans)
    matrix, pull = price * np.eye(joints), -price * shifts.ravel()
    by_subject: dict[str, np.ndarray] = {}
    for subject in dict.fromkeys(scan.subject for scan in scans):
        reduced = np.zeros((numbers + joints, numbers + joints + 1))
        for scan, e, own in zip(scans, found, solved, strict=True):
            if scan.subject == subject:
                reduced += np.column_stack([e.shared, e.shared_pull]) - e.mixed.T @ own
                shape = scan.shape
        reduced[:numbers, :numbers] += _SHAPE_COST * np.eye(numbers)
        reduced[:numbers, -1] -= _SHAPE_COST * shape
        by_subject[subject] = np.linalg.solve(reduced[:numbers, :numbers], reduced[:numbers, numbers:])
        rest = reduced[numbers:, numbers:] - reduced[numbers:, :numbers] @ by_subject[subject]
        matrix, pull = matrix + rest[:, :-1], pull + rest[:, -1]
    change = free.T @ np.linalg.solve(free @ matrix @ free.T, free @ pull)
    after = []
    for scan, own in zip(scans, solved, strict=True):
        shape_step = by_subject[scan.subject] @ np.append(-change, 1.0)
        step = own @ np.concatenate([-shape_step, -change, [1.0]])
        after.append(
            replace(
                scan,
                pose=scan.pose + np.clip(step[3:], -_LONGEST_TURN, _LONGEST_TURN).reshape(-1, 3),
                translation=scan.translation + step[:3],
                shape=scan.shape + shape_step,
            )
        )
    return after, change.reshape(-1, 3)


def _regressed(model: SurfaceModel, shifts: Float[np.ndarray, "K 3"]) -> SurfaceModel:
    """The model with a regressor, non-negative and sparse, that gives the moved joints."""
    drawn = np.random.default_rng(0).normal(size=(_DRAWN_SHAPES, model.shape_count))
    shapes = np.vstack([np.zeros(model.shape_count), drawn])
    surfaces = model.template + np.einsum("vas,hs->hva", model.shape_directions, shapes)
    wanted = with_shifted_joints(model, shifts).joint_regressor.toarray()
    joints = np.einsum("kv,hva->hka", wanted, surfaces)
    return with_regressor(model, fit_regressor(surfaces, joints, model.joint_regressor))
