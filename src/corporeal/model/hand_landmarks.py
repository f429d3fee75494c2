"""The 21 keypoints and the parts of a single hand whose file holds neither, from its joints and weights."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int

from corporeal.model.landmarks import LandmarkSet

HAND_21 = "hand_21_mediapipe"
_ORDER = ("thumb", "index", "middle", "ring", "little")
_FINGER, _THUMB = ("mcp", "pip", "dip"), ("cmc", "mcp", "ip")


def hand_landmarks(
    template: Float[np.ndarray, "V 3"],
    joints: Float[np.ndarray, "K 3"],
    weights: Float[np.ndarray, "V K"],
    joint_names: Sequence[str],
) -> LandmarkSet:
    """Wrist and finger joints, and as tips the foremost vertices of the last bones, in MediaPipe's order.

    Args:
        template: zero pose, metres.
        joints: of the template.
        weights: skinning weights.
        joint_names: K names, ``wrist`` and ``index1`` to ``thumb3``.
    """
    V = len(template)
    columns, names = [V + joint_names.index("wrist")], ["wrist"]
    for finger in _ORDER:
        chain = [joint_names.index(f"{finger}{k}") for k in (1, 2, 3)]
        columns += [V + joint for joint in chain]
        names += [f"{finger}_{part}" for part in (_THUMB if finger == "thumb" else _FINGER)]
        along = (template - joints[chain[2]]) @ (joints[chain[2]] - joints[chain[1]])
        columns.append(int(np.argmax(np.where(weights.argmax(axis=1) == chain[2], along, -np.inf))))
        names.append(f"{finger}_tip")
    entries = (np.ones(21), (np.arange(21), columns))
    return LandmarkSet(tuple(names), sp.csr_matrix(entries, shape=(21, V + len(joints))), V)


def hand_parts(
    weights: Float[np.ndarray, "V K"], joint_names: Sequence[str]
) -> dict[str, Int[np.ndarray, " _"]]:
    """Palm and five fingers: every vertex belongs to the part of the joint that moves it most."""
    strongest = weights.argmax(axis=1)
    parts = {"palm": np.flatnonzero(strongest == joint_names.index("wrist"))}
    for finger in _ORDER:
        chain = [joint_names.index(f"{finger}{k}") for k in (1, 2, 3)]
        parts[finger] = np.flatnonzero(np.isin(strongest, chain))
    return parts
