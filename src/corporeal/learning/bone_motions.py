"""First joints and poses from the parts of the surface that move with one bone alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.sparse as sp

from corporeal.learning.objective import Priors
from corporeal.learning.options import LearningOptions
from corporeal.learning.poses import fit_poses
from corporeal.learning.state import LearningState, Registrations
from corporeal.learning.templates import fit_joints, fit_templates

# A vertex with this much of its weight on one joint moves with one bone.
_RIGID = 0.9
_FEWEST = 8


def first_joints(
    state: LearningState, data: Registrations, priors: Priors, options: LearningOptions
) -> LearningState:
    """Joints, poses and translations that explain how the bones move against each other.

    The flesh around a joint follows neither bone: with all vertices, the webs of the fingers drew the
    knuckles 3 mm towards the wrist, and pose correctives, which can express any shift of a joint exactly ((R
    - I) d is linear in the features), then made up for it. Therefore joints come before correctives, from
    nearly rigid vertices. Where a joint turns about one axis only, its place along it is the start model's.
    """
    rigid = _rigid_vertices(state)
    held = state.joints
    some = replace(
        state,
        templates=state.templates[:, rigid],
        weights=state.weights[rigid],
        pose_directions=np.zeros((len(state.pose_directions), 3 * len(rigid))),
        regressor=sp.csr_matrix((len(state.parents), len(rigid))),
    )
    part = replace(data, vertices=np.ascontiguousarray(data.vertices[:, rigid]))
    part_priors = replace(
        priors,
        templates=priors.templates[:, rigid],
        weights=priors.weights[rigid],
        distances=priors.distances[:, rigid],
    )
    for _ in range(options.first_passes):
        some = fit_poses(some, part)
        some = fit_templates(some, part, part_priors, options)
        some = fit_joints(some, part, priors.joint_strengths, held)
    return replace(state, joints=some.joints, rotations=some.rotations, translations=some.translations)


def _rigid_vertices(state: LearningState) -> np.ndarray:
    """Vertices of one bone; of a bone with few of them, those that follow it most."""
    marked = state.weights.max(axis=1) > _RIGID
    for joint in range(len(state.parents)):
        own = state.weights[:, joint]
        if (own > _RIGID).sum() < _FEWEST:
            marked[np.argsort(-own, kind="stable")[:_FEWEST]] = True
    return np.flatnonzero(marked)
