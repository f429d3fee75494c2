"""How far every vertex is from every joint along the surface (equation 10 of Romero et al. 2017)."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int

from corporeal.geometry.topology import connected_components
from corporeal.learning.training_set import LearningError


def geodesic_joint_distances(
    vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], regressor: sp.csr_matrix
) -> Float[np.ndarray, "K V"]:
    """Weighted mean of the geodesic distances to a joint's regressor vertices, metres.

    The geodesic distance to a mean of points is not defined; the mean of the distances stands for it.
    Distances by the heat method (Crane et al. 2013).

    Raises:
        LearningError: a vertex that no surface joins to a joint: the template is in pieces.
    """
    import potpourri3d

    # The solver gives finite numbers across gaps as well.
    loose = int(np.count_nonzero(connected_components(faces, len(vertices))))
    if loose:
        raise LearningError(
            f"template: {loose} of {len(vertices)} vertices do not hang together with the rest; geodesic "
            "distances need one connected surface: weld it, or drop loose vertices"
        )
    solver = potpourri3d.MeshHeatMethodDistanceSolver(
        np.ascontiguousarray(vertices, dtype=np.float64), np.ascontiguousarray(faces, dtype=np.int64)
    )
    sources = np.unique(regressor.indices)
    fields = np.stack([solver.compute_distance(int(source)) for source in sources])
    distances = np.asarray(regressor[:, sources] @ fields)
    return np.maximum(distances, 0)
