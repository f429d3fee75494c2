"""The kinematic tree of a body with fingers, from one with or without."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Int

from corporeal.model.merging.errors import MergeError
from corporeal.model.surface_model import SurfaceModel

SIDES = ("left", "right")


@dataclass(frozen=True, eq=False)
class MergedTree:
    """Joints of the merged model.

    Attributes:
        names: K names.
        parents: (K,).
        of_body: (K of the body,) new index of every joint of the body; of a hand without fingers that of the
            wrist, which takes its weights.
        kept: (K of the body,) whether the joint itself is in the new tree.
        of_hand: side -> (K of the hand,) new index of every joint of the hand; the hand's root is the wrist.
        fingers_in_body: the body had these fingers.
    """

    names: tuple[str, ...]
    parents: Int[np.ndarray, " K"]
    of_body: Int[np.ndarray, " k"]
    kept: Bool[np.ndarray, " k"]
    of_hand: dict[str, Int[np.ndarray, " h"]]
    fingers_in_body: bool


def merged_tree(body: SurfaceModel, hand: SurfaceModel) -> MergedTree:
    """The body's tree with the hand's joints under each wrist, ``left_`` and ``right_`` before their names.

    A body without fingers ends in ``left_hand`` and ``right_hand``, which go: fingers come last, left first
    (SMPL becomes SMPL+H).

    Raises:
        MergeError: no wrists, some fingers only, or other fingers than the hand's.
    """
    for side in SIDES:
        if f"{side}_wrist" not in body.joint_names:
            raise MergeError(f"body {body.name!r}: has no joint '{side}_wrist'; expected a whole body")
    fingers = hand.joint_names[1:]
    wanted = [f"{side}_{name}" for side in SIDES for name in fingers]
    there = [name for name in wanted if name in body.joint_names]
    if there and len(there) < len(wanted):
        missing = next(name for name in wanted if name not in body.joint_names)
        raise MergeError(f"body {body.name!r}: has fingers, but no joint {missing!r} as the hand's")
    ends = () if there else tuple(f"{side}_hand" for side in SIDES)
    kept = np.array([name not in ends for name in body.joint_names])
    names = [name for name, stays in zip(body.joint_names, kept, strict=True) if stays]
    if not there:
        names += wanted
    place = {name: index for index, name in enumerate(names)}
    heir = {f"{side}_hand": f"{side}_wrist" for side in SIDES} if not there else {}
    parent_names = {
        name: body.joint_names[parent] if parent >= 0 else None
        for name, parent in zip(body.joint_names, body.parents, strict=True)
    }
    of_hand = {}
    for side in SIDES:
        hand_names = [f"{side}_wrist", *(f"{side}_{name}" for name in fingers)]
        of_hand[side] = np.array([place[name] for name in hand_names])
        above = {hand_names[k]: hand_names[int(hand.parents[k])] for k in range(1, hand.joint_count)}
        if there and any(parent_names[name] != parent for name, parent in above.items()):
            raise MergeError(
                f"body {body.name!r}: its {side} fingers hang together otherwise than the hand's"
            )
        parent_names |= above
    above_all = [parent_names[name] for name in names]
    parents = [-1 if parent is None else place[parent] for parent in above_all]
    of_body = np.array([place[heir.get(name, name)] for name in body.joint_names])
    return MergedTree(tuple(names), np.array(parents), of_body, kept, of_hand, bool(there))
