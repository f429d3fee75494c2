"""Jacobians of a field whose points depend on few parameters each: groups of points, without most zeros."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from corporeal.solve.curvature import Curvature, SparseCurvature


@dataclass(frozen=True, eq=False)
class SlopeGroup:
    """Points that depend on the same few parameters.

    Attributes:
        count: n; of ``points`` the first n are the group's own.
        points: (m,) its own points, then those that a curvature couples them to.
        columns: (a,) the parameters that ``points`` depend on.
        slopes: (m, 3, a).
    """

    count: int
    points: Int[np.ndarray, " m"]
    columns: Int[np.ndarray, " a"]
    slopes: Float[np.ndarray, "m 3 a"]

    @property
    def own(self) -> Float[np.ndarray, "n3 a"]:
        """Rows of the group's own points."""
        return self.slopes[: self.count].reshape(3 * self.count, -1)


@dataclass(frozen=True, eq=False)
class GroupedSlopes:
    """The Jacobian (n, 3, Q) of a field, by groups; every point is one group's own.

    Attributes:
        groups: of points.
        shape: (n, 3, Q).
    """

    groups: tuple[SlopeGroup, ...]
    shape: tuple[int, int, int]

    @classmethod
    def of_whole(cls, slopes: Float[np.ndarray, "n 3 Q"]) -> GroupedSlopes:
        """A Jacobian whose points depend on all parameters, as one group."""
        count, _, size = slopes.shape
        return cls((SlopeGroup(count, np.arange(count), np.arange(size), slopes),), (count, 3, size))

    def dense(self) -> Float[np.ndarray, "n3 Q"]:
        """All rows, with their zeros."""
        whole = np.zeros(self.shape)
        for group in self.groups:
            axes = np.arange(3)[:, None]
            whole[group.points[: group.count, None, None], axes, group.columns] = group.slopes[: group.count]
        return whole.reshape(-1, self.shape[2])

    def pulled_gradient(self, gradient: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " Q"]:
        """J^T gradient."""
        pulled = np.zeros(self.shape[2])
        for group in self.groups:
            pulled[group.columns] += group.own.T @ gradient[group.points[: group.count]].ravel()
        return pulled

    def pulled_curvature(self, curvature: Curvature) -> Float[np.ndarray, "Q Q"]:
        """J^T curvature J.

        Raises:
            ValueError: the curvature couples a point to one that is not in its group.
        """
        if not isinstance(curvature, SparseCurvature):
            whole = self.dense()
            return whole.T @ curvature.times(whole)
        pulled = np.zeros((self.shape[2], self.shape[2]))
        place = np.empty(self.shape[0], dtype=np.int64)
        for group in self.groups:
            place[:] = -1
            place[group.points] = np.arange(len(group.points))
            product = curvature.rows_times(group.points[: group.count], place, group.slopes)
            pulled[np.ix_(group.columns, group.columns)] += group.own.T @ product
        return pulled

    def narrowed(self, narrowed: Callable[[np.ndarray], np.ndarray]) -> GroupedSlopes:
        """By fewer unknowns, on which the parameters depend linearly: rows (m, Q) -> rows (m, n)."""
        groups = []
        unit = narrowed(np.eye(self.shape[2]))
        for group in self.groups:
            rows = np.zeros((3 * len(group.points), self.shape[2]))
            rows[:, group.columns] = group.slopes.reshape(-1, len(group.columns))
            columns = np.flatnonzero((unit[group.columns] != 0).any(axis=0))
            slopes = narrowed(rows)[:, columns].reshape(len(group.points), 3, len(columns))
            groups.append(SlopeGroup(group.count, group.points, columns, slopes))
        return GroupedSlopes(tuple(groups), (*self.shape[:2], unit.shape[1]))
