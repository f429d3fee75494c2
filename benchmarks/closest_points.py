"""Closest points against libigl: time ratio, time per query, largest difference of the distances.

    python benchmarks/closest_points.py [--json FILE] [--baseline FILE]

"moved" rows ask again after the mesh or the points have moved a little, from the faces of the last answer, as
registration does in every iteration; libigl builds its tree anew when the mesh has moved and keeps it when
only the points have. "cold" rows have no last answer. Points lie around the surface, 2 mm standard deviation
unless the row says otherwise, in random order.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import igl
import numpy as np
from measure import Row, paired_ratio, report

from corporeal.geometry.closest_points import SurfaceTree

LIMIT = 0.5
REPEATS = 15
TURN = np.array([0.002, -0.003, 0.001])  # radians between one question and the next
SHIFT = np.array([5e-4, -3e-4, 4e-4])  # metres


@dataclass(frozen=True, eq=False)
class Scene:
    """A surface of F faces, N points, and both a little later; metres."""

    vertices: np.ndarray
    faces: np.ndarray
    points: np.ndarray

    @property
    def moved_vertices(self) -> np.ndarray:
        """Bent by millimetres: no rigid motion."""
        return self.vertices + 1e-3 * np.sin(7 * self.vertices[:, ::-1])

    @property
    def moved_points(self) -> np.ndarray:
        """Turned and shifted by millimetres."""
        return self.points + np.cross(TURN, self.points) + SHIFT


def ring_body(around: int, across: int, size: float) -> tuple[np.ndarray, np.ndarray]:
    """A closed ring with bulges, 2 * around * across faces."""
    u, v = np.meshgrid(
        np.arange(around) * (2 * np.pi / around), np.arange(across) * (2 * np.pi / across), indexing="ij"
    )
    tube = 0.12 * (1 + 0.3 * np.sin(3 * u) + 0.2 * np.cos(5 * u + v))
    radius = 0.5 * (1 + 0.2 * np.cos(2 * u)) + tube * np.cos(v)
    vertices = np.stack([radius * np.cos(u), 1.6 * radius * np.sin(u), tube * np.sin(v)], axis=-1)
    index = np.arange(around * across).reshape(around, across)
    ahead, aside = np.roll(index, -1, axis=0), np.roll(index, -1, axis=1)
    both = np.roll(ahead, -1, axis=1)
    faces = np.concatenate(
        [np.stack(c, -1).reshape(-1, 3) for c in ((index, ahead, both), (index, both, aside))]
    )
    return size * vertices.reshape(-1, 3), faces


def scene(around: int, across: int, size: float, count: int, noise: float) -> Scene:
    """Points around random places of the surface, uniform by area."""
    rng = np.random.default_rng(20171)
    vertices, faces = ring_body(around, across, size)
    corners = vertices[faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    chosen = rng.choice(len(faces), count, p=area / area.sum())
    on_surface = np.einsum("nc,ncd->nd", rng.dirichlet(np.ones(3), count), corners[chosen])
    return Scene(vertices, faces, on_surface + rng.normal(scale=noise, size=(count, 3)))


def compare(
    name: str, ours: Callable[[], np.ndarray], theirs: Callable[[], np.ndarray], limit: float | None
) -> Row:
    """One row; both calls give squared distances of the same points."""
    here, there = np.sqrt(ours()), np.sqrt(theirs())
    ratio = paired_ratio(ours, theirs, REPEATS)
    per_query = 1e9 * ratio.ours_seconds / len(here)
    difference = np.abs(here - there).max()
    if difference > 1e-6:
        raise SystemExit(f"{name}: distances differ from libigl's by {difference:.2g} m")
    return Row(name, ratio, limit, f"{per_query:.0f} ns per query, differs by {difference:.1e} m at most")


def rows_of(label: str, s: Scene, limit: float | None) -> list[Row]:
    """All four questions about one scene."""
    tree = SurfaceTree(s.vertices, s.faces)
    last = tree.closest(s.points).faces
    their_tree = igl.AABB()
    their_tree.init(s.vertices, s.faces)
    moved_vertices, moved_points = s.moved_vertices, s.moved_points

    def refit_and_ask() -> np.ndarray:
        tree.refit(moved_vertices)
        return tree.closest(s.points, last).squared_distances

    def build_and_ask() -> np.ndarray:
        return SurfaceTree(s.vertices, s.faces).closest(s.points).squared_distances

    def their_ask(points: np.ndarray) -> np.ndarray:
        return their_tree.squared_distance(s.vertices, s.faces, points)[0]

    def their_build_and_ask(vertices: np.ndarray) -> np.ndarray:
        return igl.point_mesh_squared_distance(s.points, vertices, s.faces)[0]

    rows = [
        compare(f"{label}, mesh moved", refit_and_ask, lambda: their_build_and_ask(moved_vertices), limit),
        compare(f"{label}, cold, with build", build_and_ask, lambda: their_build_and_ask(s.vertices), None),
    ]
    tree.refit(s.vertices)
    rows += [
        compare(
            f"{label}, points moved",
            lambda: tree.closest(moved_points, last).squared_distances,
            lambda: their_ask(moved_points),
            limit,
        ),
        compare(
            f"{label}, cold",
            lambda: tree.closest(s.points).squared_distances,
            lambda: their_ask(s.points),
            None,
        ),
    ]
    return rows


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--json", type=Path, help="write the rows to this file")
    parser.add_argument("--baseline", type=Path, help="compare with a file that --json wrote")
    arguments = parser.parse_args()
    rows = [
        *rows_of("13,776 faces, 50,000 points", scene(168, 41, 1.0, 50_000, 2e-3), LIMIT),
        *rows_of("the same, points 30 cm away", scene(168, 41, 1.0, 50_000, 0.3), None),
        *rows_of("4,800 faces, 40,000 points", scene(80, 30, 0.15, 40_000, 2e-3), None),
        *rows_of("200,000 faces, 5,000 points", scene(500, 200, 0.15, 5_000, 2e-3), None),
    ]
    return report("closest points", rows, json_path=arguments.json, baseline=arguments.baseline)


if __name__ == "__main__":
    raise SystemExit(main())
