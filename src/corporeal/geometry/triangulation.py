"""Points from their pictures in many views, some of which are wrong."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float

# Bounds the memory of the search over pairs to a few tens of megabytes.
_PAIRS_AT_ONCE = 256


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
    projections: Float[np.ndarray, "*b C 3 4"],
    pixels: Float[np.ndarray, "*b C N 2"],
    weights: Float[np.ndarray, "*b C N"] | None = None,
    iterations: int = 3,
) -> Float[np.ndarray, "*b N 3"]:
    """Linear triangulation (Hartley and Zisserman 2004, chapter 12.2), rows scaled by their depth.

    Args:
        projections: world to homogeneous pixels; any number of leading dimensions.
        pixels: observations of the same N points in every view.
        weights: of every observation; ones if None.
        iterations: the algebraic error is the reprojection error times the depth; every iteration after the
            first divides by the last depth.

    Returns:
        Points in the world; NaN where the views do not define them (parallel rays, one centre).
    """
    share = np.ones(pixels.shape[:-1]) if weights is None else weights
    depth = np.ones(pixels.shape[:-1])
    camera = projections[..., :, None, :, :]
    for _ in range(iterations):
        rows = pixels[..., None] * camera[..., 2:3, :] - camera[..., :2, :]
        rows = rows * (np.sqrt(share) / depth)[..., None, None]
        normal = np.einsum("...cnra,...cnrb->...nab", rows[..., :3], rows[..., :3])
        right = -np.einsum("...cnra,...cnr->...na", rows[..., :3], rows[..., 3])
        points = _solve_or_nan(normal, right)
        depth = np.einsum("...ca,...na->...cn", projections[..., 2, :3], points)
        depth = np.maximum(np.abs(depth + projections[..., 2, 3:]), 1e-9)
    return points


def _solve_or_nan(normal: np.ndarray, right: np.ndarray) -> np.ndarray:
    normal = np.where(np.isfinite(normal), normal, 0.0)
    scale = np.trace(normal, axis1=-2, axis2=-1)[..., None, None] / 3
    # Below this determinant of the scaled matrix, less than half of float64's digits of the point are left.
    good = np.linalg.det(normal / np.where(scale > 0, scale, 1)) > 1e-12
    safe = np.where(good[..., None, None], normal, np.eye(3))
    points = np.linalg.solve(safe, right[..., None])[..., 0]
    return np.where(good[..., None], points, np.nan)


def reprojection(
    projections: Float[np.ndarray, "C 3 4"],
    pixels: Float[np.ndarray, "C N 2"],
    points: Float[np.ndarray, "*b N 3"],
) -> Float[np.ndarray, "*b C N"]:
    """Distance in pixels between observations and projected points; NaN for points that are NaN."""
    projected = np.einsum("cij,...nj->...cni", projections[..., :3], points) + projections[:, None, :, 3]
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
        iterations: of reweighting; single observations beyond three tolerances hardly count.

    Returns:
        The triangulation, or None with fewer than two views, or where no pair of views defines the points.
    """
    if len(pixels) < 2:
        return None
    agreeing = _largest_consensus(projections, pixels, tolerance)
    if agreeing.sum() < 2:
        return None
    used = projections[agreeing], pixels[agreeing]
    points = triangulate(*used)
    for _ in range(iterations):
        residual = reprojection(*used, points)
        # The scale stays at the tolerance: one that narrowed to twice the typical residual was tried, and let
        # single landmarks jump by 27 mm between turned copies of one scan.
        weights = (tolerance**2 / (tolerance**2 + residual**2)) ** 2
        # Nearly zero, not zero: where every view is far off the point stays defined.
        points = triangulate(*used, np.where(residual > 3 * tolerance, 1e-12 * weights, weights))
    residuals = reprojection(projections, pixels, points)
    if not np.isfinite(residuals).all():
        return None
    return Triangulation(points, residuals, np.median(residuals, axis=1) < tolerance)


def _largest_consensus(
    projections: np.ndarray, pixels: np.ndarray, tolerance: float
) -> Bool[np.ndarray, " C"]:
    """The views that agree with the points of the best pair; of equally many, those that agree closest."""
    pairs = np.array(list(combinations(range(len(pixels)), 2)))
    best_rank, best = (0, 0.0), np.zeros(len(pixels), bool)
    for some in np.array_split(pairs, max(1, len(pairs) // _PAIRS_AT_ONCE)):
        points = triangulate(projections[some], pixels[some], iterations=1)
        median = np.median(reprojection(projections, pixels, points), axis=-1)
        agreeing = median < tolerance
        counts = agreeing.sum(axis=1)
        closeness = np.where(agreeing, tolerance - median, 0.0).sum(axis=1)
        first = int(np.lexsort((closeness, counts))[-1])
        rank = (int(counts[first]), float(closeness[first]))
        if rank > best_rank:
            best_rank, best = rank, agreeing[first]
    return best
