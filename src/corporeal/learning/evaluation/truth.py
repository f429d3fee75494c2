"""A model against the truth of a simulation, at true pose and with the true template."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from corporeal.learning.evaluation.alignment import rigid_onto
from corporeal.learning.evaluation.results import Summary, TruthResult

_MM = 1e3


def compare_with_truth(
    label: str,
    surfaces: Float[np.ndarray, "n V 3"],
    surfaces_without: Float[np.ndarray, "n V 3"],
    truth: Float[np.ndarray, "n V 3"],
    *,
    joints: tuple[Float[np.ndarray, "n J 3"], Float[np.ndarray, "n J 3"]] | None = None,
    aligned: bool = False,
    limit: float | None = None,
) -> TruthResult:
    """R^2 = 1 - |truth - model|^2 / |truth - model without correctives|^2, and errors.

    R^2 is pooled: both sums run over all scans, so that a scan counts by how much flesh moved in it. Its
    median and worst are over the scans one by one; a nearly flat scan has little to explain and may lie far
    below.

    Args:
        label: of the model.
        surfaces: the model with correctives, metres.
        surfaces_without: the same model at the same poses without them.
        truth: the true surfaces at the same vertices.
        joints: the model's joint centres and the true ones, or None.
        aligned: lay both surfaces of every scan rigidly onto the truth first, each by itself (the joints go
            with the surface that has correctives). Where pose and template are the truth's own it is not
            needed, and flatters; it is for a model whose root lies elsewhere than the truth's.
        limit: least pooled R^2 that is asked for.

    Raises:
        ValueError: no scan, or a model that without correctives is the truth already.
    """
    if not len(truth):
        raise ValueError("truth: expected one scan at least")
    centres, true_centres = joints if joints is not None else (None, None)
    if aligned:
        surfaces, centres = _aligned(surfaces, truth, centres)
        surfaces_without, _ = _aligned(surfaces_without, truth, None)
    left, whole = truth - surfaces, truth - surfaces_without
    unexplained, total = ((part**2).sum(axis=(1, 2)) for part in (left, whole))
    if not total.all():
        raise ValueError("surfaces_without: are the truth in some scan; there is nothing to explain")
    by_scan = 1 - unexplained / total
    joint_error = None
    if centres is not None and true_centres is not None:
        joint_error = _summary(true_centres - centres)
    return TruthResult(
        label=label,
        r_squared=float(1 - unexplained.sum() / total.sum()),
        r_squared_median=float(np.median(by_scan)),
        r_squared_worst=float(by_scan.min()),
        aligned=aligned,
        error=_summary(left),
        error_without=_summary(whole),
        joint_error=joint_error,
        n_scans=len(truth),
        limit=limit,
    )


def _aligned(
    surfaces: Float[np.ndarray, "n V 3"],
    truth: Float[np.ndarray, "n V 3"],
    centres: Float[np.ndarray, "n J 3"] | None,
) -> tuple[Float[np.ndarray, "n V 3"], Float[np.ndarray, "n J 3"] | None]:
    moved = np.empty_like(surfaces)
    moved_centres = None if centres is None else np.empty_like(centres)
    for scan, (surface, target) in enumerate(zip(surfaces, truth, strict=True)):
        R, t = rigid_onto(surface, target)
        moved[scan] = surface @ R.T + t
        if centres is not None and moved_centres is not None:
            moved_centres[scan] = centres[scan] @ R.T + t
    return moved, moved_centres


def _summary(offsets: Float[np.ndarray, "n m 3"]) -> Summary:
    return Summary.of(_MM * np.linalg.norm(offsets, axis=2).ravel())
