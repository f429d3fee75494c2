"""One person's model: the learned rig around a template of their own."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from corporeal.geometry.rotations_numeric import axis_angle_from_matrix, matrix_from_axis_angle
from corporeal.learning.objective import Priors
from corporeal.learning.options import LearningOptions
from corporeal.learning.poses import fit_poses
from corporeal.learning.state import LearningState, Registrations
from corporeal.learning.templates import fit_templates
from corporeal.model.surface_model import SurfaceModel
from corporeal.solve.blas_threads import single_threaded_blas

# Observations per vertex that the model's template counts for. With learning's own 0.5 a person 2 mm off the
# mean was met to 0.24 mm from six registrations, with this to 0.15 mm, the noise.
# Joints follow the template, not the template its joints.
_JOINT_STRENGTH = 1e-3
_TEMPLATE_STRENGTH = 0.02


@dataclass(frozen=True, eq=False)
class PersonalTemplate:
    """A person's template (V, 3) at the zero pose, poses (n, K, 3), translations (n, 3); metres, radians."""

    template: Float[np.ndarray, "V 3"]
    poses: Float[np.ndarray, "n K 3"]
    translations: Float[np.ndarray, "n 3"]


def personal_model(model: SurfaceModel, template: Float[np.ndarray, "V 3"]) -> SurfaceModel:
    """The model with a person's template put in and no shape directions; joints by the model's regressor.

    Raises:
        ValueError: a template of another number of vertices.
    """
    if template.shape != model.template.shape:
        raise ValueError(f"template: shape {template.shape}, the model has {model.template.shape}")
    return model.replace(
        template=np.asarray(template, dtype=np.float64), shape_directions=np.zeros((len(template), 3, 0))
    )


def personal_template(
    model: SurfaceModel,
    vertices: Float[np.ndarray, "n V 3"],
    poses: Float[np.ndarray, "n K 3"],
    translations: Float[np.ndarray, "n 3"],
    passes: int = 6,
) -> PersonalTemplate:
    """A person's template from several registrations; correctives, weights and regressor stay as they are.

    Template and poses in turn; the joints follow the template through the regressor.

    Args:
        model: of the registrations' side and topology.
        vertices: registrations of one hand, metres.
        poses: axis-angle where they stood, radians: start values.
        translations: start values, metres.
        passes: over templates and poses.

    Raises:
        ValueError: shapes that do not fit the model, or no registration.
    """
    n = len(vertices)
    if n == 0 or vertices.shape[1:] != model.template.shape or poses.shape[1:] != (model.joint_count, 3):
        raise ValueError(
            f"vertices {vertices.shape} and poses {poses.shape}: expected some registrations of "
            f"{model.vertex_count} vertices and {model.joint_count} joints"
        )
    options = LearningOptions(template_strength=_TEMPLATE_STRENGTH)
    template = np.asarray(model.template, dtype=np.float64)[None]
    K, V = model.joint_count, model.vertex_count
    held = np.tile(_JOINT_STRENGTH * np.eye(3), (1, K, 1, 1))
    priors = Priors(template, model.skinning_weights, held, np.zeros((K - 1, V)))
    state, data = _state(model, vertices, poses, translations)
    with single_threaded_blas():
        for _ in range(passes):
            state = fit_poses(state, data)
            state = fit_templates(state, data, priors, options)
            state = _with_regressed_joints(state)
        state = fit_poses(state, data)
    return PersonalTemplate(state.templates[0], _axis_angles(state), state.translations)


def fitted_poses(
    model: SurfaceModel,
    vertices: Float[np.ndarray, "n V 3"],
    poses: Float[np.ndarray, "n K 3"],
    translations: Float[np.ndarray, "n 3"],
    passes: int = 10,
) -> PersonalTemplate:
    """The poses that bring the model, its template kept, nearest to registrations; squared distances.

    Args:
        model: of one person.
        vertices: registrations, metres.
        poses: axis-angle, radians: start values.
        translations: start values, metres.
        passes: each of two damped Gauss-Newton steps.
    """
    state, data = _state(model, vertices, poses, translations)
    with single_threaded_blas():
        for _ in range(passes):
            state = fit_poses(state, data)
    return PersonalTemplate(state.templates[0], _axis_angles(state), state.translations)


def _state(
    model: SurfaceModel, vertices: np.ndarray, poses: np.ndarray, translations: np.ndarray
) -> tuple[LearningState, Registrations]:
    """Registrations of one hand, and the model as a state of learning."""
    n, K, V = len(vertices), model.joint_count, model.vertex_count
    directions = np.zeros((9 * (K - 1), 3 * V))
    if model.has_correctives:
        directions[:] = model.pose_directions.reshape(3 * V, -1).T
    template = np.asarray(model.template, dtype=np.float64)[None]
    rotations = matrix_from_axis_angle(poses.reshape(-1, 3).astype(np.float64)).reshape(n, K, 3, 3)
    state = LearningState(
        templates=template,
        joints=(model.joint_regressor @ template[0])[None],
        weights=model.skinning_weights,
        pose_directions=directions,
        regressor=model.joint_regressor,
        rotations=rotations,
        translations=np.asarray(translations, dtype=np.float64),
        parents=model.parents,
    )
    data = Registrations(np.asarray(vertices, dtype=np.float64), np.zeros(n, dtype=np.int64), np.ones(n))
    return state, data


def _axis_angles(state: LearningState) -> Float[np.ndarray, "n K 3"]:
    n, K = state.rotations.shape[:2]
    return axis_angle_from_matrix(state.rotations.reshape(-1, 3, 3)).reshape(n, K, 3)


def _with_regressed_joints(state: LearningState) -> LearningState:
    return replace(state, joints=(state.regressor @ state.templates[0])[None])
