"""The five official families as records: joints, tree, pose blocks. No code knows a family by name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Int


@dataclass(frozen=True)
class BlockLayout:
    """A pose block of a family.

    Attributes:
        name: of the block.
        joints: its joints.
        hand_suffix: ending of the keys ``hands_mean``, ``hands_components`` and ``hands_coeffs`` that hold
            its statistics; None where the layout holds none.
    """

    name: str
    joints: tuple[int, ...]
    hand_suffix: str | None = None


@dataclass(frozen=True)
class Family:
    """One official layout.

    Attributes:
        name: short, as in file names.
        title: as it is written.
        joint_names: K names.
        parents: K parents, -1 for the root.
        blocks: the pose blocks; together they hold every joint but the root.
        single_hand: whether it is one hand, with a side.
        expressions: whether the directions are shape followed by expression, and face landmarks may be there.
    """

    name: str
    title: str
    joint_names: tuple[str, ...]
    parents: tuple[int, ...]
    blocks: tuple[BlockLayout, ...]
    single_hand: bool = False
    expressions: bool = False


# Number of columns of "shapedirs" in files with expressions -> shape and expression directions.
EXPRESSION_SPLITS = {400: (300, 100), 150: (100, 50), 20: (10, 10), 10: (10, 0)}

_FINGERS = ("index", "middle", "little", "ring", "thumb")
_BODY = {
    "pelvis": -1, "left_hip": 0, "right_hip": 0, "spine1": 0, "left_knee": 1, "right_knee": 2, "spine2": 3,
    "left_ankle": 4, "right_ankle": 5, "spine3": 6, "left_foot": 7, "right_foot": 8, "neck": 9,
    "left_collar": 9, "right_collar": 9, "head": 12, "left_shoulder": 13, "right_shoulder": 14,
    "left_elbow": 16, "right_elbow": 17, "left_wrist": 18, "right_wrist": 19,
}  # fmt: skip
_FACE = {"jaw": 15, "left_eye": 15, "right_eye": 15}
_HEAD = {"root": -1, "neck": 0, "jaw": 1, "left_eye": 1, "right_eye": 1}


def _hand(first: int, wrist: int, prefix: str = "") -> dict[str, int]:
    joints = {}
    for finger_number, finger in enumerate(_FINGERS):
        for phalanx in range(3):
            joint = first + 3 * finger_number + phalanx
            joints[f"{prefix}{finger}{phalanx + 1}"] = wrist if phalanx == 0 else joint - 1
    return joints


def _family(
    name: str, title: str, tree: dict[str, int], blocks: Sequence[BlockLayout], **flags: bool
) -> Family:
    return Family(name, title, tuple(tree), tuple(tree.values()), tuple(blocks), **flags)


def _span(first: int, end: int) -> tuple[int, ...]:
    return tuple(range(first, end))


FAMILIES = (
    _family(
        "mano", "MANO", {"wrist": -1} | _hand(1, 0), [BlockLayout("hand", _span(1, 16), "")], single_hand=True
    ),
    _family("smpl", "SMPL", _BODY | {"left_hand": 20, "right_hand": 21}, [BlockLayout("body", _span(1, 24))]),
    _family(
        "smplh",
        "SMPL+H",
        _BODY | _hand(22, 20, "left_") | _hand(37, 21, "right_"),
        [
            BlockLayout("body", _span(1, 22)),
            BlockLayout("left_hand", _span(22, 37), "l"),
            BlockLayout("right_hand", _span(37, 52), "r"),
        ],
    ),
    _family(
        "smplx",
        "SMPL-X",
        _BODY | _FACE | _hand(25, 20, "left_") | _hand(40, 21, "right_"),
        [
            BlockLayout("body", _span(1, 22)),
            BlockLayout("jaw", (22,)),
            BlockLayout("leye", (23,)),
            BlockLayout("reye", (24,)),
            BlockLayout("left_hand", _span(25, 40), "l"),
            BlockLayout("right_hand", _span(40, 55), "r"),
        ],
        expressions=True,
    ),
    _family(
        "flame",
        "FLAME",
        _HEAD,
        [BlockLayout(n, (j,)) for n, j in (("neck", 1), ("jaw", 2), ("leye", 3), ("reye", 4))],
        expressions=True,
    ),
)


def family_of_tree(parents: Int[np.ndarray, " K"]) -> Family | None:
    """The family with that kinematic tree (all five differ), or None."""
    wanted = tuple(int(parent) for parent in parents)
    return next((family for family in FAMILIES if family.parents == wanted), None)
