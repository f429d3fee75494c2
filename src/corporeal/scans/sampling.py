"""A few points that stand for all of a scan, evenly spread over its surface."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int64

_MOST_CELLS = 1 << 22
_STEPS = 8


def sample_points(points: Float[np.ndarray, "N 3"], count: int, seed: int = 0) -> Int64[np.ndarray, " n"]:
    """Indices of min(count, N) points, at most about one in every cube of a grid.

    Scanners and decimated meshes have far more points in some places than in others; one point in a cube
    makes the sample even in area. The cubes are shrunk until there are enough of them, and the surplus is
    dropped at random. Deterministic for one seed.

    Args:
        points: any unit; finite.
        count: how many are wanted, at least 1.
        seed: of the choice within a cube.

    Returns:
        Indices in rising order, each at most once.

    Raises:
        ValueError: ``count`` is less than 1.
    """
    if count < 1:
        raise ValueError(f"count: expected at least 1, got {count}")
    if len(points) <= count:
        return np.arange(len(points), dtype=np.int64)
    generator = np.random.default_rng(seed)
    order = generator.permutation(len(points))
    lowest = points.min(axis=0)
    relative = (points - lowest)[order]
    extent = relative.max(axis=0)
    # A surface that fills its box as a sheet does has about area / cell^2 cells: a first guess from the box.
    cell = float(np.sqrt(max(np.sort(extent)[1:].prod() / count, 0.0))) or float(extent.max()) / count
    best: np.ndarray | None = None
    for _ in range(_STEPS if cell > 0 else 0):
        chosen = _one_per_cell(relative, extent, cell)
        if len(chosen) >= count and (best is None or len(chosen) < len(best)):
            best = chosen
        if count <= len(chosen) <= 1.15 * count:
            break
        # Occupied cells of a surface grow with the inverse square of their size; aim at 7 % more than wanted.
        cell *= float(np.sqrt(len(chosen) / (1.07 * count)))
    if best is None:
        best = np.arange(len(points))  # so many points at the same places that no grid parts them
    kept = best if len(best) == count else generator.choice(best, count, replace=False)
    return np.sort(order[kept]).astype(np.int64)


def _one_per_cell(relative: np.ndarray, extent: np.ndarray, cell: float) -> np.ndarray:
    """The last point of every occupied cell."""
    shape = np.floor(extent / cell).astype(np.int64) + 1
    place = (relative / cell).astype(np.int64)
    keys = (place[:, 0] * shape[1] + place[:, 1]) * shape[2] + place[:, 2]
    if float(np.prod(shape.astype(np.float64))) > _MOST_CELLS:
        return np.unique(keys, return_index=True)[1]
    holder = np.full(int(np.prod(shape)), -1, dtype=np.int64)
    holder[keys] = np.arange(len(keys))
    return holder[holder >= 0]
