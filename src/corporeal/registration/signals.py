"""What the verdict is measured by: named numbers of one finished fit."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from corporeal.geometry.normals import areas_around
from corporeal.geometry.topology import unique_edges
from corporeal.registration.measures import SurfaceDistances, mean_offsets, surface_coverage
from corporeal.registration.priors import prior_terms
from corporeal.solve.problem import PARAMETERS
from corporeal.terms.model_fields import LANDMARKS, MODEL

if TYPE_CHECKING:
    from corporeal.registration.stages import Fitter

# Where the scan's surface turns its back on the registration's, the two do not speak of the same skin.
_TURNED_AWAY = 0.0
# An offset of the scan that is left when its noise is averaged out: the registration is not there.
_MISFIT = 1e-3
_FEWEST_POINTS = 1.0


def measured_signals(
    fitter: Fitter,
    vector: Float[np.ndarray, " Q"],
    vertices: Float[np.ndarray, "V 3"],
    distances: SurfaceDistances,
    model_distances: SurfaceDistances,
) -> dict[str, float]:
    """All signals of a finished fit; one that this scan does not allow is absent.

    Args:
        fitter: model, scan and landmarks.
        vector: the fitted parameters.
        vertices: the registration, metres.
        distances: scan to registration.
        model_distances: scan to the fitted model alone.

    Returns:
        Name -> value; names and units are those of ``judgement.Bounds``.
    """
    fields = fitter.fields.derive(vector)
    summary = distances.summary_mm()
    signals = {
        "s2m_mean_mm": summary["mean"],
        "s2m_p95_mm": summary["p95"],
        "model_s2m_mean_mm": model_distances.summary_mm()["mean"],
        "unscored_share": 1 - distances.scored_share,
        "penetration_mm": 1e3 * _deepest(fitter, vertices),
    }
    if distances.cosines is not None and distances.scored.any():
        signals["turned_share"] = float((distances.cosines[distances.scored] < _TURNED_AWAY).mean())
    return (
        signals
        | _misfit(fitter, vertices, distances)
        | _coverage(fitter, vertices)
        | _priors(fitter, vector)
        | _departure(fitter, vertices, fields[MODEL])
        | _landmarks(fitter, fields)
    )


def _misfit(fitter: Fitter, vertices: np.ndarray, distances: SurfaceDistances) -> dict[str, float]:
    """The scan's mean offset around a vertex, over the area of the vertices that have points."""
    faces = fitter.model.faces
    offsets, counts = mean_offsets(distances, fitter.target.scan.points, faces, len(vertices))
    areas = areas_around(vertices, faces)
    areas[counts < _FEWEST_POINTS] = 0
    if not areas.any():
        return {}
    metres = np.linalg.norm(offsets, axis=1)
    share = areas / areas.sum()
    return {
        "misfit_rms_mm": 1e3 * float(np.sqrt(share @ metres**2)),
        "misfit_share": float(share @ (metres > _MISFIT)),
    }


def _coverage(fitter: Fitter, vertices: np.ndarray) -> dict[str, float]:
    """Registration to scan; a point cloud does not say where its holes are."""
    surface = fitter.target.surface
    if surface is None:
        return {}
    coverage = surface_coverage(vertices, fitter.model.faces, surface)
    return {"far_share": coverage.far_share, "hole_share": coverage.hole_share}


def _priors(fitter: Fitter, vector: np.ndarray) -> dict[str, float]:
    """Distances from the model's own priors, per degree of freedom: 1 is what the priors expect.

    The prior of a protocol pose is left aside: it is narrow, and the second round's verdict must mean the
    same as the first's.
    """
    terms = prior_terms(
        fitter.model, fitter.fields.columns, shape_sigma=1.0, pose_prior_scale=1.0,
        limit_sigma=fitter.options.limit_sigma,
    )  # fmt: skip
    costs = {term.name: term.at({PARAMETERS: vector}).cost for term in terms}
    parameters = fitter.fields.parameters(vector)
    shape = parameters.shape
    signals = {
        "shape_norm": float(np.sqrt(np.mean(shape**2))) if len(shape) else 0.0,
        "largest_shape": float(np.abs(shape).max(initial=0.0)),
    }
    blocks = fitter.model.pose_blocks
    if blocks:
        freedoms = sum(3 * len(block.joints) for block in blocks)
        energy = sum(costs[f"{block.name} prior"] for block in blocks)
        signals["pose_deviation"] = float(np.sqrt(2 * energy / freedoms))
        beyond = sum(costs.get(f"{block.name} limits", 0.0) for block in blocks)
        signals["beyond_limits_degrees"] = float(np.rad2deg(fitter.options.limit_sigma * np.sqrt(2 * beyond)))
    return signals


def _departure(fitter: Fitter, vertices: np.ndarray, model_vertices: np.ndarray) -> dict[str, float]:
    """How the free vertices left the model: strain of the edges, and distance."""
    edges = unique_edges(fitter.model.faces)
    lengths = [
        np.linalg.norm(field[edges[:, 0]] - field[edges[:, 1]], axis=1)
        for field in (vertices, model_vertices)
    ]
    strain = lengths[0] / np.maximum(lengths[1], 1e-6) - 1
    moved = 1e3 * np.linalg.norm(vertices - model_vertices, axis=1)
    return {
        "edge_strain_rms": float(np.sqrt(np.mean(strain**2))),
        "edge_strain_p99": float(np.percentile(np.abs(strain), 99)),
        "free_mean_mm": float(moved.mean()),
        "free_p99_mm": float(np.percentile(moved, 99)),
    }


def _landmarks(fitter: Fitter, fields: dict[str, np.ndarray]) -> dict[str, float]:
    """Disagreement with the landmarks that were found or given."""
    if fitter.landmarks is None:
        return {}
    off = 1e3 * np.linalg.norm(fields[LANDMARKS] - fitter.landmarks.positions, axis=1)
    return {"landmark_median_mm": float(np.median(off)), "landmark_p90_mm": float(np.percentile(off, 90))}


def _deepest(fitter: Fitter, vertices: np.ndarray) -> float:
    return 0.0 if fitter.parts is None else fitter.parts.penetration(vertices).deepest
