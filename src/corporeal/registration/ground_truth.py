"""Registrations against the truth of a simulated session; it reads arrays, never files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from corporeal.geometry.normals import vertex_normals

TRUE_FAILURE_MM = 4.0
"""A registration has truly failed when its vertices are farther than this from the truth in the mean."""


@dataclass(frozen=True)
class TruthErrors:
    """Errors of one registration, millimetres.

    Attributes:
        v2v: mean distance of a vertex from its true position, over all vertices of the template.
        v2v_median: of the same distances.
        v2v_p95: their 95th percentile.
        v2v_max: their largest.
        normal: mean size of the part along the true surface's normal: off the surface.
        tangential: mean size of the part within the true surface: at a wrong place of it.
        joints: mean distance of the joints; None where they are not known.
    """

    v2v: float
    v2v_median: float
    v2v_p95: float
    v2v_max: float
    normal: float
    tangential: float
    joints: float | None


@dataclass(frozen=True)
class Flagging:
    """How well a status tells true failures.

    Attributes:
        scans: how many have a truth.
        true_failures: mean v2v above the limit, or no registration at all.
        failures_marked_failed: share of them with the status failed.
        failures_marked_doubtful: share of them with the status doubtful.
        others_marked_failed: share of the other scans with the status failed: false alarms.
        others_marked_doubtful: the same for doubtful.
        without_registration: scans without one; they are among the true failures.
    """

    scans: int
    true_failures: int
    failures_marked_failed: float | None
    failures_marked_doubtful: float | None
    others_marked_failed: float | None
    others_marked_doubtful: float | None
    without_registration: int


def errors_against_truth(
    vertices: Float[np.ndarray, "V 3"],
    true_vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    joints: Float[np.ndarray, "K 3"] | None = None,
    true_joints: Float[np.ndarray, "K 3"] | None = None,
) -> TruthErrors:
    """Compare a registration with the true positions of the template's vertices.

    Args:
        vertices: the registration, metres.
        true_vertices: in the same frame and order, metres.
        faces: of the template; either winding, since only the size of the normal part is used.
        joints: of the fitted model in that frame, metres, or None.
        true_joints: in the same order, metres, or None.

    Raises:
        ValueError: coordinates that are not finite.
    """
    if not (np.isfinite(vertices).all() and np.isfinite(true_vertices).all()):
        raise ValueError("vertices and true_vertices: expected finite coordinates")
    offsets = 1e3 * (vertices - true_vertices)
    normals = vertex_normals(np.asarray(true_vertices, dtype=np.float64), faces)
    along = np.einsum("va,va->v", offsets, normals)
    within = np.linalg.norm(offsets - along[:, None] * normals, axis=1)
    distances = np.linalg.norm(offsets, axis=1)
    joint_error = None
    if joints is not None and true_joints is not None:
        joint_error = float(1e3 * np.linalg.norm(joints - true_joints, axis=1).mean())
    return TruthErrors(
        v2v=float(distances.mean()),
        v2v_median=float(np.median(distances)),
        v2v_p95=float(np.percentile(distances, 95)),
        v2v_max=float(distances.max()),
        normal=float(np.abs(along).mean()),
        tangential=float(within.mean()),
        joints=joint_error,
    )


def flagging(
    statuses: Mapping[str, str], v2v_mm: Mapping[str, float | None], limit_mm: float = TRUE_FAILURE_MM
) -> Flagging:
    """Count true failures that were flagged, and false alarms.

    Args:
        statuses: scan -> ok, doubtful or failed.
        v2v_mm: scan -> mean v2v, or None where there is no registration; scans without a truth are left out.
        limit_mm: above it a registration has truly failed.

    Raises:
        KeyError: a scan with a truth has no status.
    """
    bad = [name for name, value in v2v_mm.items() if value is None or not value <= limit_mm]
    good = sorted(set(v2v_mm) - set(bad))

    def share(names: list[str], status: str) -> float | None:
        return sum(statuses[name] == status for name in names) / len(names) if names else None

    return Flagging(
        scans=len(v2v_mm),
        true_failures=len(bad),
        failures_marked_failed=share(bad, "failed"),
        failures_marked_doubtful=share(bad, "doubtful"),
        others_marked_failed=share(good, "failed"),
        others_marked_doubtful=share(good, "doubtful"),
        without_registration=sum(value is None for value in v2v_mm.values()),
    )
