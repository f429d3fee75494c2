"""Points from their pictures in many views, some of which are wrong."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float


@dataclass(frozen=True, eq=False)
class Triangulation:
    """Points that a consensus of views agrees on.

    Attributes:
        points: (N, 3) in the frame and unit of the projections.
        residuals: (C, N) distance in pixels between every view's observation and the projected point.
        agreeing: (C,) views whose median residual is within the tolerance.
    """

    points: Float[np.ndarray, "N 3"]
    residuals: Float[np.ndarray, "C N"]
    agreeing: Bool[np.ndarray, " C"]


def triangulate(
    projections: Float[np.ndarray, "C 3 4"],
    pixels: Float[np.ndarray, "C N 2"],
    weights: Float[np.ndarray, "C N"] | None = None,
) -> Float[np.ndarray, "N 3"]:
    """Linear triangulation (Hartley and Zisserman 2004, chapter 12.2), rows scaled by their depth.

    Args:
        projections: world to homogeneous pixels.
        pixels: observations of the same N points in every view.
        weights: of every observation; ones if None.
    """
    views, count = pixels.shape[:2]
    share = np.ones((views, count)) if weights is None else weights
    points = np.zeros((count, 3))
    depth = np.ones((views, count))
    # The algebraic error is the reprojection error times the depth: dividing by the last depth mends that.
    for _ in range(3):
        rows = pixels[..., None] * projections[:, None, 2:3] - projections[:, None, :2]
        rows = rows * (np.sqrt(share) / depth)[..., None, None]
        A = rows.transpose(1, 0, 2, 3).reshape(count, 2 * views, 4)
        normal = np.einsum("nra,nrb->nab", A[..., :3], A[..., :3])
        right = -np.einsum("nra,nr->na", A[..., :3], A[..., 3])
        points = np.linalg.solve(normal, right[..., None])[..., 0]
        homogeneous = np.concatenate([points, np.ones((count, 1))], axis=1)
        depth = np.maximum(np.abs(np.einsum("ca,na->cn", projections[:, 2], homogeneous)), 1e-9)
    return points


def reprojection(
    projections: Float[np.ndarray, "C 3 4"],
    pixels: Float[np.ndarray, "C N 2"],
    points: Float[np.ndarray, "N 3"],
) -> Float[np.ndarray, "C N"]:
    """Distance in pixels between observations and projected points."""
    homogeneous = np.concatenate([points, np.ones((len(points), 1))], axis=1)
    projected = np.einsum("cab,nb->cna", projections, homogeneous)
    return np.linalg.norm(projected[..., :2] / projected[..., 2:] - pixels, axis=-1)


def robust_triangulation(
    projections: Float[np.ndarray, "C 3 4"],
    pixels: Float[np.ndarray, "C N 2"],
    tolerance: float,
    *,
    iterations: int = 10,
) -> Triangulation | None:
    """Consensus over pairs of views, then reweighting of single observations (Geman-McClure).

    All pairs are tried: with a few dozen views that is cheaper than sampling, and the same in every run.

    Args:
        projections: world to homogeneous pixels.
        pixels: observations of the same N points in every view.
        tolerance: residual in pixels that an agreeing view may have in the median, and the robust scale.
        iterations: of reweighting.

    Returns:
        The triangulation, or None with fewer than two views, or where no pair of views defines the points.
    """
    best: tuple[int, float, np.ndarray] | None = None
    for pair in combinations(range(len(pixels)), 2):
        index = list(pair)
        try:
            points = triangulate(projections[index], pixels[index])
        except np.linalg.LinAlgError:
            continue
        median = np.median(reprojection(projections, pixels, points), axis=1)
        agreeing = median < tolerance
        rank = (int(agreeing.sum()), -float(np.minimum(median, tolerance).sum()))
        if best is None or rank > best[:2]:
            best = (*rank, agreeing)
    if best is None or best[0] < 2:
        return None
    used = np.flatnonzero(best[2])
    weights = np.ones((len(used), pixels.shape[1]))
    points = triangulate(projections[used], pixels[used], weights)
    for _ in range(iterations):
        residual = reprojection(projections[used], pixels[used], points)
        weights = (tolerance**2 / (tolerance**2 + residual**2)) ** 2
        points = triangulate(projections[used], pixels[used], weights)
    residuals = reprojection(projections, pixels, points)
    return Triangulation(points, residuals, np.median(residuals, axis=1) < tolerance)
