"""What joining does to the surface where hand and forearm meet."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float, Int

from corporeal.geometry.topology import unique_edges
from corporeal.model.jacobian import evaluate
from corporeal.model.merging.tree import SIDES
from corporeal.model.surface_model import SurfaceModel

_WRIST = np.deg2rad(60.0)
_OTHERS = np.deg2rad(20.0)
# Metres behind the hand's border that count as its seam.
_ZONE = 0.02


def seam_edges(
    faces: Int[np.ndarray, "F 3"], count: int, behind: Mapping[str, tuple[np.ndarray, np.ndarray]]
) -> Int[np.ndarray, "E 2"]:
    """Edges from the body into the hand, and those of the hand that begin within 20 mm behind them.

    How wide the hand is faded in does not change them, so that widths compare.

    Args:
        faces: of the body.
        count: of its vertices.
        behind: side -> vertices of the hand, and metres of each behind the seam.
    """
    distance = np.full(count, np.inf)
    inside = np.zeros(count, dtype=bool)
    for vertices, distances in behind.values():
        distance[vertices] = distances
        inside[vertices] = True
    edges = unique_edges(faces)
    crossing = inside[edges[:, 0]] != inside[edges[:, 1]]
    near = (distance[edges].min(axis=1) < _ZONE) & inside[edges].all(axis=1)
    return edges[crossing | near]


def seam_poses(merged: SurfaceModel, poses: int, rng: np.random.Generator) -> Float[np.ndarray, "n K 3"]:
    """Random poses: wrists by 60 degrees about any axis, hands as their pose spaces say, the rest by 20.

    The first six of every hundred turn both wrists about one axis alone, which is where it is worst.
    """
    turns = _OTHERS * rng.standard_normal((poses, merged.joint_count, 3)) / np.sqrt(3)
    for side in SIDES:
        axes = rng.standard_normal((poses, 3))
        for number in range(poses):
            if number % 100 < 6:
                axes[number] = (-1) ** (number % 2) * np.eye(3)[(number % 100) // 2]
        wrist = merged.joint_names.index(f"{side}_wrist")
        turns[:, wrist] = _WRIST * axes / np.linalg.norm(axes, axis=1, keepdims=True)
        block = merged.block(f"{side}_hand")
        coefficients = rng.standard_normal((poses, len(block.components))) * block.component_deviations
        turns[:, list(block.joints)] = (block.mean + coefficients @ block.components).reshape(poses, -1, 3)
    return turns


def seam_jump(
    body: SurfaceModel, merged: SurfaceModel, edges: Int[np.ndarray, "E 2"],
    *, poses: int = 200, seed: int = 0,
) -> float:  # fmt: skip
    """The largest jump of the displacement (merged minus body) across an edge of the seam, metres.

    Over random poses of the merged model, which the body takes too as far as it has the joints.
    """
    if not len(edges):
        return 0.0
    worst = 0.0
    common = [k for k, name in enumerate(merged.joint_names) if name in body.joint_names]
    own = [body.joint_names.index(merged.joint_names[k]) for k in common]
    for turns in seam_poses(merged, poses, np.random.default_rng(seed)):
        carried = np.zeros((body.joint_count, 3))
        carried[own] = turns[common]
        first, second = (
            evaluate(model, np.zeros(0), pose, np.zeros(3)).vertices
            for model, pose in ((body, carried), (merged, turns))
        )
        moved = second - first
        worst = max(worst, float(np.linalg.norm(moved[edges[:, 0]] - moved[edges[:, 1]], axis=1).max()))
    return worst
