"""Where fits of a model to a scan begin: on a registration of the scan, so that no detector is needed."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from corporeal.learning.evaluation.alignment import rigid_onto
from corporeal.learning.evaluation.protocols import FitProtocol, free_shape_count
from corporeal.model.jacobian import evaluate
from corporeal.model.surface_model import SurfaceModel
from corporeal.registration.starts import turned
from corporeal.solve.dogleg import DoglegOptions, solve
from corporeal.solve.problem import Problem, State, Term
from corporeal.terms.gaussian_prior import GaussianPrior
from corporeal.terms.landmarks import LandmarkDistances
from corporeal.terms.model_fields import MODEL, ModelFields, ModelParameters

# Standard deviation of a registered vertex in metres, and of an axis-angle number in radians.
_VERTEX_SIGMA, _POSE_SIGMA = 3e-3, 1.0


def start_on(
    model: SurfaceModel,
    pose: Float[np.ndarray, "K 3"],
    vertices: Float[np.ndarray, "V 3"],
    protocol: FitProtocol,
    *,
    correctives: bool = True,
) -> ModelParameters:
    """Where a fit begins: the model laid onto a registration of the scan, vertex by vertex.

    Models differ in their joints, about which pose and root turn: the registration's pose in another model,
    laid on rigidly, was 4 mm off, fitted to its vertices 1 mm. The start then favours no model.

    Args:
        model: of the registration's side and topology.
        pose: axis-angle of the registration, radians, from which its vertices are fitted.
        vertices: of the registration, metres.
        protocol: what is free.
        correctives: as in the fit.

    Raises:
        ValueError: shapes that do not fit the model, or a model that does not suit the protocol.
    """
    if vertices.shape != model.template.shape or pose.shape != (model.joint_count, 3):
        raise ValueError(
            f"vertices {vertices.shape}, pose {pose.shape}: expected {model.template.shape} and "
            f"({model.joint_count}, 3) of {model.name!r}; compared models share template and tree"
        )
    count = free_shape_count(model, protocol)
    fields = ModelFields(model, shape_count=count, correctives=correctives)
    shape, pose = np.zeros(count), pose.astype(np.float64)
    R, t = rigid_onto(evaluate(model, shape, pose, np.zeros(3)).vertices, vertices)
    begun = turned(model, pose, shape, R, t)
    after_root = slice(fields.columns.pose.start + 3, fields.columns.pose.stop)
    terms: list[Term] = [
        LandmarkDistances("registration", MODEL, vertices, np.full(len(vertices), _VERTEX_SIGMA)),
        GaussianPrior.isotropic("pose", after_root, np.zeros(pose.size - 3), _POSE_SIGMA),
        GaussianPrior.isotropic("shape", fields.columns.shape, shape, 1.0),
    ]
    problem = Problem(terms, fields.derive, fields.differentiate)
    found = solve(problem, State(begun), DoglegOptions(iterations=20, relative_decrease=1e-3))
    return fields.parameters(found.state.parameters if found.outcome.usable else begun)
