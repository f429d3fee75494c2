"""Free vertices coupled to a posed model: the surface of equations 20 and 23, the pose held."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from corporeal.fitting.frame_data import FramePoints
from corporeal.fitting.options import FreeStage, TrackingOptions
from corporeal.solve.curvature import PerAxisCurvature
from corporeal.solve.sparse import factorised
from corporeal.terms.coupling import EdgeCoupling
from corporeal.terms.distance import DistanceOptions
from corporeal.terms.model_fields import MODEL
from corporeal.terms.scan_to_surface import MovingSurface, ScanToSurface

FREE = "free"
_ANNEALING = 500.0
# Edges alone do not see the surface drift away as a whole.
_POSITION_SIGMA = 0.05


def coupled_vertices(
    model_vertices: Float[np.ndarray, "V 3"],
    surface: MovingSurface,
    points: FramePoints,
    options: TrackingOptions,
    held: Bool[np.ndarray, " F"],
    stage: FreeStage,
) -> Float[np.ndarray, "V 3"]:
    """Vertices that follow the scan and keep the model's edges where there is none, or where they are held.

    The energy is minimised over the vertices with the pose held; poses are solved for apart. With 18,056
    vertices the arrow system of both together would take its 190 right-hand sides at every step.

    Args:
        model_vertices: of the posed model, metres.
        surface: its topology.
        points: of the scan.
        options: of tracking.
        held: faces that do not follow the scan: of hands, whose scans are webs between fingers.
        stage: how far they follow it.

    Raises:
        ArithmeticError: the system is singular.
    """
    edges = surface.edges
    lengths = np.linalg.norm(model_vertices[edges[:, 0]] - model_vertices[edges[:, 1]], axis=1)
    relative = 1 / np.maximum(lengths, 1e-4) ** 2
    coupling = EdgeCoupling(
        "coupling",
        (FREE, MODEL),
        edges,
        len(model_vertices),
        sigma=float(np.sqrt(_ANNEALING / stage.coupling)),
        position_sigma=_POSITION_SIGMA,
        weights=relative,
    )
    sigma = float(1 / np.sqrt(_ANNEALING * options.weights.data))
    cosine = -1.0 if points.normals is None else options.minimum_cosine
    closest = surface.closest(model_vertices, points.positions, None)
    followed = np.flatnonzero(~held[closest.faces])
    own, shares = points.some(followed), np.ones(len(followed))
    distance = DistanceOptions(sigma, stage.robust_scale, 1.0, cosine)
    data = ScanToSurface(
        "scan", FREE, surface, own.positions, shares, own.normals, distance, closest.faces[followed]
    )
    vertices = model_vertices.copy()
    for _ in range(stage.passes):
        fields = {FREE: vertices, MODEL: model_vertices}
        pulls, holds = data.at(fields).quadratic(), coupling.at(fields).quadratic()
        curvature = pulls.curvature[FREE, FREE].plus(holds.curvature[FREE, FREE])
        if not isinstance(curvature, PerAxisCurvature):
            raise TypeError("free vertices: their curvature must be the same for x, y and z")
        vertices = vertices - factorised(curvature.matrix).solve(pulls.gradient[FREE] + holds.gradient[FREE])
    return vertices
