"""Where a hand model lies on a body: which vertices of the body are which points of the hand."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int

from corporeal.geometry.closest_points import ClosestPoints, SurfaceTree
from corporeal.geometry.mesh_matching import matched_from
from corporeal.model.merging.errors import MergeError
from corporeal.model.surface_model import SurfaceModel

# Hands of one mesh may be of people that differ by this; a mesh of another place does not come so near.
_SAME = 30e-3
_TRIED = 60
# Surfaces of two templates of one hand in one pose lie within this in the median; else they are not laid
# onto one another.
_NEAR = 5e-3
# A body vertex takes part where the hand's surface is so near.
_REACH = 15e-3
_LARGEST_TURN = 15.0
_SCALES = (0.7, 1.4)


@dataclass(frozen=True, eq=False)
class HandPlacement:
    """A hand on a body; n vertices of the body take part.

    Attributes:
        vertices: (n,) of the body.
        from_hand: (n, V of the hand) sparse; every such vertex as a point of the hand, rows sum to one.
        from_body: (V of the hand, V of the body) sparse; every vertex of the hand as a point of the body.
        method: "given", "same topology" or "closest points".
        largest: metres between the two templates at their wrists, largest over the vertices.
    """

    vertices: Int[np.ndarray, " n"]
    from_hand: sp.csr_matrix
    from_body: sp.csr_matrix
    method: str
    largest: float


def given_placement(body: SurfaceModel, hand: SurfaceModel, vertices: Int[np.ndarray, " h"]) -> HandPlacement:
    """The body's vertex of every vertex of the hand is known.

    Raises:
        MergeError: another number than the hand has vertices, one twice, one that the body does not have, or
            a hand that is turned against the body's: their zero poses differ.
    """
    if len(vertices) != hand.vertex_count:
        raise MergeError(
            f"vertices: {len(vertices)} for a hand of {hand.vertex_count}; give the body's index of each"
        )
    if len(np.unique(vertices)) < len(vertices) or vertices.min() < 0:
        raise MergeError("vertices: the same vertex twice, or a negative one")
    if vertices.max() >= body.vertex_count:
        raise MergeError(f"vertices: {vertices.max()}, but the body has {body.vertex_count}")
    _check_zero_pose(hand.template, body.template[vertices])
    return _one_to_one(body, hand, vertices, "given")


def found_placement(
    body: SurfaceModel, hand: SurfaceModel, body_joints: Int[np.ndarray, " k"]
) -> HandPlacement:
    """Vertex for vertex where both have one mesh, else by closest points of the two surfaces.

    Args:
        body: with its own fingers.
        hand: in the same zero pose.
        body_joints: the body's joint of every joint of the hand; they tell where the hand lies.

    Raises:
        MergeError: the two hands do not lie on one another.
    """
    source = hand.joint_regressor @ hand.template
    target = (body.joint_regressor @ body.template)[body_joints]
    shift = target.mean(axis=0) - source.mean(axis=0)
    scale = float(np.linalg.norm(target - target.mean(axis=0)) / np.linalg.norm(source - source.mean(axis=0)))
    if not _SCALES[0] < scale < _SCALES[1]:
        raise MergeError(
            f"hand {hand.name!r} is {1 / scale:.3g} times as large as the hand of {body.name!r}; are both in "
            "metres?"
        )
    _check_zero_pose(source, target)
    vertices = _same_mesh(body, hand, hand.template + shift)
    if vertices is not None:
        return _one_to_one(body, hand, vertices, "same topology")
    laid = (hand.template - source.mean(axis=0)) * scale + target.mean(axis=0)
    return _closest(body, hand, laid, body_joints)


def _same_mesh(
    body: SurfaceModel, hand: SurfaceModel, laid: Float[np.ndarray, "h 3"]
) -> Int[np.ndarray, " h"] | None:
    """The body's vertices of the hand's mesh: tried from the body's triangles around the hand's first one."""
    centre = laid[hand.faces[0]].mean(axis=0)
    near = np.argsort(np.linalg.norm(body.template[body.faces].mean(axis=1) - centre, axis=1))[:_TRIED]
    for face in body.faces[near].tolist():
        for corner in range(3):
            first = (face[corner], face[(corner + 1) % 3], face[(corner + 2) % 3])
            found = matched_from(hand.faces, body.faces, first)
            if found is not None and np.linalg.norm(body.template[found] - laid, axis=1).max() < _SAME:
                return found
    return None


def _one_to_one(body: SurfaceModel, hand: SurfaceModel, vertices: np.ndarray, method: str) -> HandPlacement:
    n = len(vertices)
    order = np.argsort(vertices, kind="stable")
    ones = np.ones(n)
    apart = body.template[vertices] - hand.template
    apart = np.linalg.norm(apart - np.median(apart, axis=0), axis=1)
    return HandPlacement(
        vertices[order].astype(np.int64),
        sp.csr_matrix((ones, (np.arange(n), order)), shape=(n, n)),
        sp.csr_matrix((ones, (np.arange(n), vertices)), shape=(n, body.vertex_count)),
        method,
        float(apart.max()),
    )


def _closest(
    body: SurfaceModel, hand: SurfaceModel, laid: Float[np.ndarray, "h 3"], body_joints: np.ndarray
) -> HandPlacement:
    """Only vertices that the body itself hangs on the hand's joints take part: a thigh may be near."""
    own = body.skinning_weights[:, body_joints].sum(axis=1) > 0.5
    candidates = np.flatnonzero(own)
    if not len(candidates):
        raise MergeError(f"{body.name!r}: no vertex follows its hand; give the vertices of the hand")
    onto_hand = SurfaceTree(laid, hand.faces).closest(body.template[candidates])
    near = onto_hand.distances < _REACH
    vertices = candidates[near]
    if not len(vertices) or np.median(onto_hand.distances) > _NEAR:
        raise MergeError(
            f"hand {hand.name!r} lies {1e3 * np.median(onto_hand.distances):.1f} mm from that of "
            f"{body.name!r} in the median (at most {1e3 * _NEAR:g}): other shapes or zero poses. Register "
            "one template to the other and give the vertices"
        )
    kept = own[body.faces].all(axis=1)
    onto_body = SurfaceTree(body.template, body.faces[kept]).closest(laid)
    return HandPlacement(
        vertices,
        _barycentric(onto_hand, hand.faces, hand.vertex_count)[near],
        _barycentric(onto_body, body.faces[kept], body.vertex_count),
        "closest points",
        float(onto_hand.distances[near].max()),
    )


def _barycentric(found: ClosestPoints, faces: np.ndarray, count: int) -> sp.csr_matrix:
    n = len(found.faces)
    rows = np.repeat(np.arange(n), 3)
    columns = faces[found.faces].ravel()
    return sp.csr_matrix((found.barycentric.ravel(), (rows, columns)), shape=(n, count))


def _check_zero_pose(source: Float[np.ndarray, "n 3"], target: Float[np.ndarray, "n 3"]) -> None:
    """Correctives and pose spaces count turns from the zero pose, in the model's axes: shared, or refused."""
    left, _, right = np.linalg.svd((target - target.mean(axis=0)).T @ (source - source.mean(axis=0)))
    turn = left @ np.diag([1, 1, np.sign(np.linalg.det(left @ right))]) @ right
    degrees = np.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1)))
    if degrees > _LARGEST_TURN:
        raise MergeError(
            f"hand: turned by {degrees:.0f} degrees against the body's (at most {_LARGEST_TURN:g}); both "
            "must share zero pose and axes, and be of one side"
        )
