"""First joints and poses from the parts of the surface that move with one bone alone."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp

from corporeal.learning import skinning_kernels as kernels
from corporeal.learning.objective import Priors
from corporeal.learning.options import LearningOptions
from corporeal.learning.poses import fit_poses
from corporeal.learning.state import LearningState, Registrations
from corporeal.learning.templates import fit_joints, fit_templates

# A vertex with this much of its weight on one joint moves with one bone.
_RIGID = 0.9
_FEWEST = 8
# After these passes every bone keeps this share of its vertices, the most rigid ones: 0.4 in all.
_CUTS = (4, 7)
_KEPT = 0.4**0.5
# Metres from which on a distance counts no more: a bad registration must not choose the vertices.
_FAR = 4e-3


def first_joints(
    state: LearningState, data: Registrations, priors: Priors, options: LearningOptions
) -> LearningState:
    """Joints, poses and translations that explain how the bones move against each other.

    The flesh around a joint follows neither bone: with all vertices, the webs of the fingers drew the
    knuckles 3 mm towards the wrist, and pose correctives, which can express any shift of a joint exactly ((R
    - I) d is linear in the features), then made up for it. Therefore joints come before correctives, from
    nearly rigid vertices; which these are the registrations tell, and skin that slides over its bone drops
    out. Where a joint turns about one axis only, its place along it is the start model's.

    Learned from half of a simulated session, joints were 2.66 mm from the true ones with all vertices of a
    bone and 2.47 with 0.4 of them (0.15 and more passes: no better); 2.04 where the true surfaces took the
    registrations' place.
    """
    part = _part(state, data, priors, _rigid_vertices(state))
    for number in range(options.first_passes):
        if number in _CUTS:
            part = _part(part.state, part.data, part.priors, _most_rigid(part))
        some = fit_poses(part.state, part.data)
        some = fit_templates(some, part.data, part.priors, options)
        some = fit_joints(some, part.data, priors.joint_strengths, state.joints)
        part = replace(part, state=some)
    some = part.state
    return replace(state, joints=some.joints, rotations=some.rotations, translations=some.translations)


@dataclass(frozen=True, eq=False)
class _Part:
    """A learning problem of some vertices, without correctives and regressor."""

    state: LearningState
    data: Registrations
    priors: Priors


def _part(state: LearningState, data: Registrations, priors: Priors, vertices: np.ndarray) -> _Part:
    some = replace(
        state,
        templates=state.templates[:, vertices],
        weights=state.weights[vertices],
        pose_directions=np.zeros((len(state.pose_directions), 3 * len(vertices))),
        regressor=sp.csr_matrix((len(state.parents), len(vertices))),
    )
    held = replace(
        priors,
        templates=priors.templates[:, vertices],
        weights=priors.weights[vertices],
        distances=priors.distances[:, vertices],
    )
    return _Part(some, replace(data, vertices=np.ascontiguousarray(data.vertices[:, vertices])), held)


def _most_rigid(part: _Part) -> np.ndarray:
    """Of every bone's vertices the share that lies nearest to the registrations."""
    state, table = part.state, part.state.weight_table()
    distances = np.zeros(state.templates.shape[1])
    for posed in state.posed(part.data):
        surface = np.empty_like(posed.rest)
        kernels.posed_vertices(table, posed.motions, posed.rest, surface)
        apart = np.linalg.norm(part.data.vertices[posed.rows] - surface, axis=2)
        distances += np.minimum(apart, _FAR).sum(axis=0)
    bones, kept = state.weights.argmax(axis=1), []
    for bone in np.unique(bones):
        own = np.flatnonzero(bones == bone)
        count = max(min(_FEWEST, len(own)), int(np.ceil(_KEPT * len(own))))
        kept.append(own[np.argsort(distances[own], kind="stable")[:count]])
    return np.sort(np.concatenate(kept))


def _rigid_vertices(state: LearningState) -> np.ndarray:
    """Vertices of one bone; of a bone with few of them, those that follow it most."""
    marked = state.weights.max(axis=1) > _RIGID
    for joint in range(len(state.parents)):
        own = state.weights[:, joint]
        if (own > _RIGID).sum() < _FEWEST:
            marked[np.argsort(-own, kind="stable")[:_FEWEST]] = True
    return np.flatnonzero(marked)
