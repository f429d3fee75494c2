"""First joints and poses from the parts of the surface that move with one bone alone."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int

from corporeal.learning import skinning_kernels as kernels
from corporeal.learning.articulation import fit_articulation
from corporeal.learning.objective import Priors
from corporeal.learning.options import LearningOptions
from corporeal.learning.poses import fit_poses
from corporeal.learning.state import LearningState, Registrations
from corporeal.learning.templates import fit_joints, fit_templates

# A vertex with this much of its weight on one joint moves with one bone.
_RIGID = 0.9
_FEWEST = 8
# In turns, until all at once has somewhere to begin.
_PASSES = 4
# How often the most rigid vertices are chosen anew; a third time moved no joint by 0.1 mm.
_CHOICES = 2
# Of a bone's vertices these are the most rigid ones, and of them so many witness how it moves.
_KEPT, _WITNESSES = 0.4, 12
# Metres from which on a distance counts no more: a bad registration must not choose the vertices.
_FAR = 4e-3
# Templates of the whole bones, by which the choice is made: hardly held.
_LOOSE = LearningOptions(template_strength=0.02)


def first_joints(state: LearningState, data: Registrations, priors: Priors) -> LearningState:
    """Joints, poses and translations that explain how the bones move against each other.

    The flesh around a joint follows neither bone: with all vertices, the webs of the fingers drew the
    knuckles 3 mm towards the wrist, and pose correctives, which can express any shift of a joint exactly ((R
    - I) d is linear in the features), then made up for it. Therefore joints come before correctives, from
    nearly rigid vertices; which these are the registrations tell, and skin that slides over its bone drops
    out. Where a joint turns about one axis only, its place along it is the start model's.

    Learned from the true surfaces of six simulated hands, joints were 2.8 mm from the true ones and poses 14
    degrees, moved in turns and with free hinges; 1.8 mm and 4 degrees so.
    """
    part = _part(state, data, priors, _rigid_vertices(state))
    some = part.state
    for _ in range(_PASSES):
        some = fit_poses(some, part.data, hinges=priors.hinges)
        some = fit_templates(some, part.data, part.priors, _LOOSE)
        some = fit_joints(some, part.data, priors.joint_strengths, state.joints)
    for _ in range(_CHOICES):
        some = fit_templates(some, part.data, part.priors, _LOOSE)
        witnesses = _part(some, part.data, part.priors, _witnesses(some, part))
        found = fit_articulation(witnesses.state, witnesses.data, witnesses.priors, state.joints)
        some = _moved(some, found)
    return _moved(state, some)


@dataclass(frozen=True, eq=False)
class _Part:
    """A learning problem of some vertices, without correctives and regressor."""

    state: LearningState
    data: Registrations
    priors: Priors


def _part(
    state: LearningState, data: Registrations, priors: Priors, vertices: Int[np.ndarray, " n"]
) -> _Part:
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


def _moved(state: LearningState, found: LearningState) -> LearningState:
    """The state with another's joints, rotations and translations."""
    return replace(state, joints=found.joints, rotations=found.rotations, translations=found.translations)


def _rigid_vertices(state: LearningState) -> Int[np.ndarray, " n"]:
    """Vertices of one bone; of a bone with few of them, those that follow it most."""
    marked = state.weights.max(axis=1) > _RIGID
    for joint in range(len(state.parents)):
        own = state.weights[:, joint]
        if (own > _RIGID).sum() < _FEWEST:
            marked[np.argsort(-own, kind="stable")[:_FEWEST]] = True
    return np.flatnonzero(marked)


def _witnesses(state: LearningState, part: _Part) -> Int[np.ndarray, " n"]:
    """Of every bone's most rigid vertices a few that lie far apart."""
    distances = _distances(state, part.data)
    bones, template, kept = state.weights.argmax(axis=1), state.templates.mean(axis=0), []
    for bone in np.unique(bones):
        own = np.flatnonzero(bones == bone)
        count = max(min(_FEWEST, len(own)), int(np.ceil(_KEPT * len(own))))
        rigid = own[np.argsort(distances[own], kind="stable")[:count]]
        kept.append(rigid[_far_apart(template[rigid], _WITNESSES)])
    return np.sort(np.concatenate(kept))


def _distances(state: LearningState, data: Registrations) -> Float[np.ndarray, " V"]:
    """Of every vertex from the registrations, summed."""
    table = state.weight_table()
    distances = np.zeros(state.templates.shape[1])
    for posed in state.posed(data):
        surface = np.empty_like(posed.rest)
        kernels.posed_vertices(table, posed.motions, posed.rest, surface)
        apart = np.linalg.norm(data.vertices[posed.rows] - surface, axis=2)
        distances += np.minimum(apart, _FAR).sum(axis=0)
    return distances


def _far_apart(points: Float[np.ndarray, "n 3"], count: int) -> Int[np.ndarray, " m"]:
    """At most so many points, each as far as may be from those before; first the farthest from the mean."""
    distances = np.linalg.norm(points - points.mean(axis=0), axis=1)
    chosen = [int(distances.argmax())]
    distances = np.linalg.norm(points - points[chosen[0]], axis=1)
    while len(chosen) < min(count, len(points)):
        chosen.append(int(distances.argmax()))
        distances = np.minimum(distances, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return np.array(chosen)
