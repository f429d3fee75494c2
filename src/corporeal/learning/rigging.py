"""A crude rig from geometry alone: skinning weights by distance to bones, joints from rings of vertices."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int
from scipy.optimize import nnls
from scipy.sparse import csgraph

from corporeal.geometry.topology import unique_edges
from corporeal.learning.weights import MOST_JOINTS

# A bone's weight has faded away at this many thicknesses of the limb along the surface. Against the weights
# that artists gave the open hand: mean difference 0.08 at 1.0, 0.14 at 1.5, 0.20 at 2.0.
_FADE = 1.0
# The tip lies on its bone: vertices are not taken to be nearer than this share of the usual thickness.
_LEAST_THICKNESS = 0.25
# Rings are looked for in discs: a vertex counts as so many times farther along the bone than across it.
_FLATTENING = 3.0
_FIRST_RING, _GROWTH = 12, 1.4
# How evenly a ring is weighed, against giving its joint exactly; both in units of the ring's radius.
_EVENNESS = 1e-4
# Share of a joint that one vertex may bear.
_LARGEST_SHARE = 0.25
# Metres by which a ring may miss its joint.
_MISS = 1e-6


def bone_weights(
    template: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    joints: Float[np.ndarray, "K 3"],
    parents: Int[np.ndarray, " K"],
    joint_names: Sequence[str],
) -> Float[np.ndarray, "V K"]:
    """Skinning weights that fade with the distance from a bone's own patch of the surface.

    A joint's patch are the vertices nearest to its bones: the segments to its children, and for a joint
    without children one more of the length of the bone above. Of a patch in pieces the largest piece stays;
    the others (of a finger that lies against another) go to the patch that is nearest along the edges. From
    its patch a joint's weight falls from one to zero as (1 - d^2)^2, where d is the distance along the
    mesh's edges in thicknesses of the limb, that is in distances of its surface from its bone. The four
    strongest joints of a vertex stay, and are made to sum to one.

    Args:
        template: zero pose, metres; one connected surface.
        faces: triangles.
        joints: of the template, metres.
        parents: -1 for the root, which comes first.
        joint_names: for the message.

    Raises:
        ValueError: a joint whose bone is nearest to no vertex.
    """
    distances = _bone_distances(template, joints, parents)
    patches = distances.argmin(axis=1)
    thickness = distances.min(axis=1)
    thickness = np.maximum(thickness, _LEAST_THICKNESS * np.median(thickness))
    edges = unique_edges(faces)
    lengths = np.linalg.norm(template[edges[:, 0]] - template[edges[:, 1]], axis=1)
    graph = _graph(edges, lengths / thickness[edges].mean(axis=1), len(template))
    _check_patches(patches, joint_names)
    patches = _in_one_piece(patches, graph)
    weights = np.empty((len(template), len(joints)))
    for joint in range(len(joints)):
        away = csgraph.dijkstra(graph, indices=np.flatnonzero(patches == joint), min_only=True, limit=_FADE)
        weights[:, joint] = np.square(1 - np.square(np.minimum(away / _FADE, 1)))
    return strongest_joints(weights)


def strongest_joints(weights: Float[np.ndarray, "V K"]) -> Float[np.ndarray, "V K"]:
    """The four largest weights of every vertex, made to sum to one."""
    kept = np.zeros_like(weights)
    order = np.argsort(-weights, axis=1, kind="stable")[:, :MOST_JOINTS]
    np.put_along_axis(kept, order, np.take_along_axis(weights, order, axis=1), axis=1)
    return kept / kept.sum(axis=1, keepdims=True)


def ring_regressor(
    template: Float[np.ndarray, "V 3"],
    joints: Float[np.ndarray, "K 3"],
    parents: Int[np.ndarray, " K"],
    weights: Float[np.ndarray, "V K"],
    joint_names: Sequence[str],
) -> sp.csr_matrix:
    """Rows, non-negative and summing to one, that give every joint from the ring of vertices around it.

    A ring are the vertices nearest to the joint in the disc across its bone, among those that the joint or
    its parent moves most. It is weighed as evenly as its giving the joint allows, and grows until the joint
    lies so well within it that no vertex bears more than a quarter.

    Args:
        template: zero pose, metres.
        joints: of the template, metres.
        parents: -1 for the root, which comes first.
        weights: skinning weights, which say whose vertices are whose.
        joint_names: for the message.

    Raises:
        ValueError: a joint that its and its parent's vertices do not surround.
    """
    rows = np.zeros((len(joints), len(template)))
    strongest = weights.argmax(axis=1)
    for joint, parent in enumerate(parents):
        own = np.flatnonzero((strongest == joint) | (strongest == parent))
        arms = template[own] - joints[joint]
        along = arms @ _axis(joints, parents, joint)
        disc = np.einsum("va,va->v", arms, arms) + (_FLATTENING**2 - 1) * along**2
        nearest = np.argsort(disc, kind="stable")
        ring = _surrounding(arms[nearest])
        if ring is None:
            raise ValueError(
                f"joints: {joint_names[joint]!r} is not surrounded by vertices that it or its parent moves; "
                "expected a place inside the template"
            )
        rows[joint, own[nearest[: len(ring)]]] = ring
    return sp.csr_matrix(rows)


def _bone_distances(
    template: Float[np.ndarray, "V 3"], joints: Float[np.ndarray, "K 3"], parents: Int[np.ndarray, " K"]
) -> Float[np.ndarray, "V K"]:
    """Distance of every vertex from the nearest bone of every joint."""
    distances = np.full((len(template), len(joints)), np.inf)
    for joint in range(len(joints)):
        ends = joints[parents == joint]
        if not len(ends):
            above = joints[joint] - joints[parents[joint]] if joint else np.zeros(3)
            ends = (joints[joint] + above)[None]
        for end in ends:
            bone, arms = end - joints[joint], template - joints[joint]
            share = np.clip(arms @ bone / max(float(bone @ bone), 1e-300), 0, 1)
            away = np.linalg.norm(arms - share[:, None] * bone, axis=1)
            distances[:, joint] = np.minimum(distances[:, joint], away)
    return distances


def _axis(
    joints: Float[np.ndarray, "K 3"], parents: Int[np.ndarray, " K"], joint: int
) -> Float[np.ndarray, "3"]:
    """Direction of the limb at a joint: between the bone that comes and those that go."""
    bones = [joints[child] - joints[joint] for child in np.flatnonzero(parents == joint)]
    going = [bone / max(float(np.linalg.norm(bone)), 1e-300) for bone in bones]
    axis = np.mean(going, axis=0) if going else np.zeros(3)
    if parents[joint] >= 0:
        coming = joints[joint] - joints[parents[joint]]
        axis = axis + coming / max(float(np.linalg.norm(coming)), 1e-300)
    return axis / max(float(np.linalg.norm(axis)), 1e-300)


def _graph(edges: Int[np.ndarray, "E 2"], lengths: Float[np.ndarray, " E"], count: int) -> sp.csr_matrix:
    # An edge of no length would be no edge.
    kept = np.maximum(lengths, 1e-9)
    return sp.csr_matrix(
        (np.tile(kept, 2), (edges.T.ravel(), edges[:, ::-1].T.ravel())), shape=(count, count)
    )


def _check_patches(patches: Int[np.ndarray, " V"], joint_names: Sequence[str]) -> None:
    missing = np.setdiff1d(np.arange(len(joint_names)), patches)
    if len(missing):
        raise ValueError(
            f"joints: no vertex is nearest to the bone of {joint_names[missing[0]]!r}; move it into its "
            "limb, or give weights"
        )


def _in_one_piece(patches: Int[np.ndarray, " V"], graph: sp.csr_matrix) -> Int[np.ndarray, " V"]:
    """The largest piece of every patch; other vertices go to the piece that is nearest along the edges."""
    stays = np.zeros(len(patches), dtype=bool)
    for joint in np.unique(patches):
        members = np.flatnonzero(patches == joint)
        _, pieces = csgraph.connected_components(graph[members][:, members], directed=False)
        stays[members[pieces == np.bincount(pieces).argmax()]] = True
    _, _, sources = csgraph.dijkstra(
        graph, indices=np.flatnonzero(stays), min_only=True, return_predecessors=True
    )
    return patches[sources]


def _surrounding(arms: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " m"] | None:
    """Weights of the first m of n arms that cancel, m as small as may be; None where not even all do."""
    count, found = min(_FIRST_RING, len(arms)), None
    while count:
        radius = max(float(np.linalg.norm(arms[:count], axis=1).mean()), 1e-300)
        equations = np.vstack([arms[:count].T / radius, np.ones((1, count)), _EVENNESS * np.eye(count)])
        wanted = np.concatenate([np.zeros(3), [1.0], np.full(count, _EVENNESS / count)])
        solved, _ = nnls(equations, wanted)
        row = solved / solved.sum()
        if np.linalg.norm(row @ arms[:count]) < _MISS:
            found = row
            if row.max() <= _LARGEST_SHARE:
                break
        if count == len(arms):
            break
        count = min(int(_GROWTH * count) + 1, len(arms))
    return found
