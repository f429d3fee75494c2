"""A body with the articulated hands of a hand model: SMPL+H's recipe (section 3.4 of Romero et al. 2017).

Blend weights, pose correctives and joint regressors of the fingers come from the hand; everything else, the
wrist included, from the body. The body's shape space decides the hands' shape too, and its template is kept.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from jaxtyping import Int

from corporeal.model.landmarks import LandmarkSet
from corporeal.model.merging.blending import (
    body_arrays,
    fade_in,
    merged_directions,
    merged_regressor,
    merged_weights,
    seam_distances,
    strongest_weights,
)
from corporeal.model.merging.errors import MergeError
from corporeal.model.merging.placement import HandPlacement, found_placement, given_placement
from corporeal.model.merging.seam import seam_edges
from corporeal.model.merging.tree import SIDES, MergedTree, merged_tree
from corporeal.model.mirror import mirror_model, swap_sides
from corporeal.model.statistics import PoseBlock
from corporeal.model.surface_model import SurfaceModel


@dataclass(frozen=True)
class MergeOptions:
    """How hands are joined to a body.

    Attributes:
        hand_components: of each hand's pose space that the model keeps: 6 are the paper's, 66 + 2 * 6 = 78
            degrees of freedom with the body; None keeps all. Full poses can be given in any case.
        most_joints: that move one vertex; the strongest stay. Renderers take four. None keeps all: where hand
            and forearm fade into one another a vertex may have joints of both.
        seam_width: metres behind the seam over which the hand's weights are faded in; its correctives over
            twice as much: learned ones still move the wrist by 2 mm in poses far from the mean. Over 20 mm
            the open hand's jumped by 1.5 mm from one vertex to the next, over 30 by 0.9, over 40 by 0.7.
    """

    hand_components: int | None = 6
    most_joints: int | None = None
    seam_width: float = 0.03


@dataclass(frozen=True, eq=False)
class Merged:
    """A merged model.

    Attributes:
        model: the body with the hands.
        placements: side -> where the hand lies on the body.
        seam: (E, 2) edges of the body over which hand and body meet.
    """

    model: SurfaceModel
    placements: dict[str, HandPlacement]
    seam: Int[np.ndarray, "E 2"]


def merge_hands(
    body: SurfaceModel,
    hand: SurfaceModel,
    other: SurfaceModel | None = None,
    vertices: Mapping[str, Int[np.ndarray, " h"]] | None = None,
    options: MergeOptions | None = None,
) -> Merged:
    """Join a hand model to both sides of a body.

    Args:
        body: a whole body with joints ``left_wrist`` and ``right_wrist``; with or without fingers.
        hand: of either side, in the body's zero pose and axes.
        other: the hand of the other side; the mirror image of ``hand`` if not given.
        vertices: side -> the body's vertex of every vertex of that hand. Without it they are found, which
            needs a body with fingers.
        options: see ``MergeOptions``.

    Raises:
        MergeError: models that do not fit together; the message says what to do.
    """
    options = options or MergeOptions()
    hands = _both_hands(body, hand, other)
    tree = merged_tree(body, hands["right"])
    placements = {side: _placed(body, hands[side], side, tree, vertices) for side in SIDES}
    weights, directions = body_arrays(body, hands["right"], tree)
    distances = {side: seam_distances(body, placements[side].vertices) for side in SIDES}
    for side, behind in distances.items():
        share = fade_in(behind, options.seam_width)
        merged_weights(hands[side], placements[side], tree, side, share, weights)
        if directions.shape[2]:
            slower = fade_in(behind, 2 * options.seam_width)
            merged_directions(hands[side], placements[side], tree, side, slower, directions)
    model = body.replace(
        joint_regressor=merged_regressor(body, hands, placements, tree),
        skinning_weights=strongest_weights(weights, options.most_joints or len(tree.names)),
        pose_directions=directions,
        parents=tree.parents.astype(body.parents.dtype),
        joint_names=tree.names,
        pose_blocks=_blocks(body, hands, tree, options.hand_components),
        landmarks=_landmarks(body, hands, placements, tree),
        mirror_joints=_mirror_joints(body, tree),
        cut=None,
        notes=dict(body.notes) | {f"hands: {key}": text for key, text in hand.notes.items()},
    )
    behind_seam = {side: (placements[side].vertices, distances[side]) for side in SIDES}
    return Merged(model, placements, seam_edges(body.faces, body.vertex_count, behind_seam))


def _both_hands(
    body: SurfaceModel, hand: SurfaceModel, other: SurfaceModel | None
) -> dict[str, SurfaceModel]:
    if body.side is not None:
        raise MergeError(f"body {body.name!r}: is a {body.side} hand; the body comes first")
    if hand.side is None:
        raise MergeError(f"hand {hand.name!r}: is not a single hand")
    other = other if other is not None else mirror_model(hand)
    if other.side is None or other.side == hand.side:
        raise MergeError(f"hand {other.name!r}: expected the hand of the other side than {hand.side}")
    if other.joint_names != hand.joint_names or not np.array_equal(other.parents, hand.parents):
        raise MergeError(f"hand {other.name!r}: has other joints than {hand.name!r}")
    return {str(hand.side): hand, str(other.side): other}


def _placed(
    body: SurfaceModel, hand: SurfaceModel, side: str, tree: MergedTree,
    vertices: Mapping[str, np.ndarray] | None,
) -> HandPlacement:  # fmt: skip
    if vertices is not None:
        if side not in vertices:
            raise MergeError(f"vertices: none for the {side} hand")
        return given_placement(body, hand, np.asarray(vertices[side], dtype=np.int64))
    if not tree.fingers_in_body:
        raise MergeError(
            f"body {body.name!r}: has no fingers by which its hands could be found; give the vertices of the "
            "hands"
        )
    names = [tree.names[joint] for joint in tree.of_hand[side]]
    joints = np.array([body.joint_names.index(name) for name in names])
    return found_placement(body, hand, joints)


def _blocks(
    body: SurfaceModel, hands: Mapping[str, SurfaceModel], tree: MergedTree, count: int | None
) -> tuple[PoseBlock, ...]:
    """The body's blocks without what their joints no longer are, and a block for each hand."""
    hand_joints = {int(joint) for side in SIDES for joint in tree.of_hand[side][1:]}
    blocks = []
    for block in body.pose_blocks:
        moved = [
            (place, int(tree.of_body[joint])) for place, joint in enumerate(block.joints) if tree.kept[joint]
        ]
        moved = [(place, joint) for place, joint in moved if joint not in hand_joints]
        if not moved:
            continue
        whole = len(moved) == len(block.joints)
        joints = tuple(joint for _, joint in moved)
        # Components over joints that are gone mean other rotations than before: nothing is known then.
        blocks.append(
            dataclasses.replace(block, joints=joints) if whole else PoseBlock.plain(block.name, joints)
        )
    for side in SIDES:
        blocks.append(_hand_block(hands[side], side, tree, count))
    return tuple(blocks)


def _hand_block(hand: SurfaceModel, side: str, tree: MergedTree, count: int | None) -> PoseBlock:
    own = [block for block in hand.pose_blocks if len(block.joints) == hand.joint_count - 1]
    joints = tuple(int(joint) for joint in tree.of_hand[side][1:])
    if not own:
        return PoseBlock.plain(f"{side}_hand", joints)
    block = own[0]
    return dataclasses.replace(
        block,
        name=f"{side}_hand",
        joints=tuple(int(tree.of_hand[side][joint]) for joint in block.joints),
        components=block.components[:count],
        component_deviations=block.component_deviations[:count],
    )


def _landmarks(
    body: SurfaceModel, hands: Mapping[str, SurfaceModel], placements: Mapping[str, HandPlacement],
    tree: MergedTree,
) -> dict[str, LandmarkSet]:  # fmt: skip
    """The body's landmarks, those at joints that are gone left out; and the hands' own."""
    V, K = body.vertex_count, len(tree.names)
    joints = sp.csr_matrix(
        (tree.kept.astype(np.float64), (np.arange(body.joint_count), tree.of_body)), (body.joint_count, K)
    )
    found = {}
    for name, landmarks in body.landmarks.items():
        gone = abs(landmarks.weights[:, V:][:, ~tree.kept]).sum(axis=1)
        rows = np.flatnonzero(np.asarray(gone).ravel() == 0)
        if len(rows):
            weights = sp.hstack([landmarks.weights[:, :V], landmarks.weights[:, V:] @ joints]).tocsr()[rows]
            found[name] = LandmarkSet(tuple(landmarks.names[row] for row in rows), weights, V)
    for side, placement in placements.items():
        hand = hands[side]
        places = sp.csr_matrix(
            (np.ones(hand.joint_count), (np.arange(hand.joint_count), tree.of_hand[side])),
            (hand.joint_count, K),
        )
        for name, landmarks in hand.landmarks.items():
            own, at = landmarks.weights[:, : hand.vertex_count], landmarks.weights[:, hand.vertex_count :]
            weights = sp.hstack([own @ placement.from_body, at @ places]).tocsr()
            names = tuple(f"{side}_{landmark}" for landmark in landmarks.names)
            # What the body already has under that name is what its users know.
            found.setdefault(f"{side}_{name}", LandmarkSet(names, weights, V))
    return found


def _mirror_joints(body: SurfaceModel, tree: MergedTree) -> Int[np.ndarray, " K"] | None:
    if body.mirror_vertices is None:
        return None
    return np.array([tree.names.index(swap_sides(name)) for name in tree.names])


def degrees_of_freedom(model: SurfaceModel) -> int:
    """Numbers of a pose, hands by their components, every other joint, the root included, by three."""
    hand_blocks = [model.block(f"{side}_hand") for side in SIDES]
    hand_joints = sum(len(block.joints) for block in hand_blocks)
    numbers = sum(len(block.components) for block in hand_blocks)
    return 3 * (model.joint_count - hand_joints) + numbers
