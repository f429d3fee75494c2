"""Pinhole cameras: x right, y down, z forward; pixel centres at integers + 0.5; metres and radians."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True, eq=False)
class Pinhole:
    """A camera without distortion.

    Attributes:
        width, height: size of the picture in pixels.
        focal: (2,) focal lengths in x and y, pixels.
        centre: (2,) principal point, pixels.
        T_camera_world: (4, 4) rigid, takes world points to camera coordinates.
    """

    width: int
    height: int
    focal: Float[np.ndarray, 2]
    centre: Float[np.ndarray, 2]
    T_camera_world: Float[np.ndarray, "4 4"]

    @classmethod
    def look_at(
        cls,
        eye: Float[np.ndarray, 3],
        target: Float[np.ndarray, 3],
        up: Float[np.ndarray, 3],
        fov: float,
        size: tuple[int, int],
    ) -> Pinhole:
        """A camera at ``eye`` that sees ``target`` in the middle of its picture.

        Args:
            eye: where the camera stands, world, metres.
            target: the world point in the middle of the picture, metres.
            up: world direction that points to the top of the picture.
            fov: angle of view across the shorter side, radians.
            size: (width, height), pixels.

        Raises:
            ValueError: the eye is at the target, or ``up`` is parallel to the line of sight.
        """
        R_camera_world = view_rotation(target - eye, up)
        return cls._of_rotation(R_camera_world, -R_camera_world @ eye, fov, size)

    @classmethod
    def fit_to_frame(
        cls,
        points: Float[np.ndarray, "N 3"],
        direction: Float[np.ndarray, 3],
        up: Float[np.ndarray, 3],
        *,
        fov: float,
        size: tuple[int, int],
        fill: float,
    ) -> Pinhole:
        """The nearest camera along ``direction`` that keeps all points within ``fill`` of the frame.

        With half-angle tangents k, a point (x, y, z) at distance d is inside when |x - s| <= k (d + z); the
        smallest d over all shifts s has a closed form, so that no search is needed.

        Args:
            points: world points, metres.
            direction: from the camera towards the points, world.
            up: world direction that points to the top of the picture.
            fov: angle of view across the shorter side, radians.
            size: (width, height), pixels.
            fill: share of width and height that the points may take, in (0, 1].

        Raises:
            ValueError: no points, or directions that are parallel.
        """
        if len(points) == 0:
            raise ValueError("points: at least one is needed to place a camera")
        R_camera_world = view_rotation(direction, up)
        rotated = points @ R_camera_world.T
        tangents = fill * np.tan(fov / 2) * np.asarray(size, float) / min(size)
        shift, distances = np.zeros(3), np.zeros(2)
        for axis, k in enumerate(tangents):
            upper = (rotated[:, axis] - k * rotated[:, 2]).max()
            lower = (-rotated[:, axis] - k * rotated[:, 2]).max()
            shift[axis] = 0.5 * (upper - lower)
            distances[axis] = 0.5 * (upper + lower) / k
        shift[2] = -distances.max()
        return cls._of_rotation(R_camera_world, -shift, fov, size)

    @classmethod
    def _of_rotation(
        cls, rotation: np.ndarray, translation: np.ndarray, fov: float, size: tuple[int, int]
    ) -> Pinhole:
        T_camera_world = np.eye(4)
        T_camera_world[:3, :3], T_camera_world[:3, 3] = rotation, translation
        focal = 0.5 * min(size) / np.tan(fov / 2)
        return cls(size[0], size[1], np.full(2, focal), 0.5 * np.asarray(size, float), T_camera_world)

    @property
    def eye(self) -> Float[np.ndarray, 3]:
        """(3,) position of the camera in the world, metres."""
        return -self.T_camera_world[:3, :3].T @ self.T_camera_world[:3, 3]

    @property
    def lens(self) -> Float[np.ndarray, 4]:
        """(4,) focal x, focal y, centre x, centre y in pixels."""
        return np.concatenate([self.focal, self.centre])

    @property
    def projection(self) -> Float[np.ndarray, "3 4"]:
        """(3, 4) matrix from homogeneous world points to homogeneous pixels."""
        intrinsics = np.eye(3)
        intrinsics[[0, 1], [0, 1]] = self.focal
        intrinsics[:2, 2] = self.centre
        return intrinsics @ self.T_camera_world[:3]

    def to_camera(self, points: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 3"]:
        """World points in the camera's frame, metres."""
        return points @ self.T_camera_world[:3, :3].T + self.T_camera_world[:3, 3]

    def project(
        self, points: Float[np.ndarray, "N 3"]
    ) -> tuple[Float[np.ndarray, "N 2"], Float[np.ndarray, " N"]]:
        """Pixels and depth (z in the camera's frame, metres) of world points.

        Points with depth <= 0 lie behind the camera; their pixels are NaN.
        """
        local = self.to_camera(points)
        depth = local[:, 2]
        safe = np.where(depth > 0, depth, np.nan)
        return local[:, :2] / safe[:, None] * self.focal + self.centre, depth

    def unproject(
        self, pixels: Float[np.ndarray, "N 2"], depth: Float[np.ndarray, " N"]
    ) -> Float[np.ndarray, "N 3"]:
        """World points of pixels at a depth: the inverse of ``project``."""
        flat = (pixels - self.centre) / self.focal
        local = np.concatenate([flat, np.ones((len(flat), 1))], axis=1) * depth[:, None]
        return (local - self.T_camera_world[:3, 3]) @ self.T_camera_world[:3, :3]


def view_rotation(direction: Float[np.ndarray, 3], up: Float[np.ndarray, 3]) -> Float[np.ndarray, "3 3"]:
    """Rotation from world to a camera that looks along ``direction`` with ``up`` towards the picture's top.

    Raises:
        ValueError: a direction of no length, or ``up`` parallel to ``direction``.
    """
    right = np.cross(direction, up)
    # A sine below 1e-9 leaves no digits for the roll of the picture.
    if np.linalg.norm(right) <= 1e-9 * np.linalg.norm(direction) * np.linalg.norm(up):
        raise ValueError("up: must not be parallel to the line of sight, and neither may be zero")
    z = direction / np.linalg.norm(direction)
    x = right / np.linalg.norm(right)
    return np.stack([x, np.cross(z, x), z])
