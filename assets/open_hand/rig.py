"""From the source's bones to the hand's 16 joints, and from its rest pose to the flat zero pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

FINGERS = ("index", "middle", "little", "ring", "thumb")
_SOURCE = {"index": "Index", "middle": "Middle", "little": "Pinky", "ring": "Ring", "thumb": "Thumb"}
JOINT_NAMES = ("wrist", *(f"{finger}{k}" for finger in FINGERS for k in (1, 2, 3)))
PARENTS = np.array([-1, *(0 if k == 0 else 3 * f + k for f in range(5) for k in range(3))])
FINGERTIP = "End"


def bone_groups() -> list[list[str]]:
    """Source bones of every joint, the bone whose head is the joint first; metacarpals go with the wrist."""
    groups = [["RightHand", *(f"RightHand{_SOURCE[f]}1" for f in FINGERS if f != "thumb")]]
    for finger in FINGERS:
        first = 1 if finger == "thumb" else 2
        for k in range(3):
            group = [f"RightHand{_SOURCE[finger]}{first + k}"]
            groups.append([*group, f"RightHand{_SOURCE[finger]}{FINGERTIP}"] if k == 2 else group)
    return groups


def tip_bones() -> list[str]:
    """The bone at the tip of every finger, in the order of ``FINGERS``."""
    return [f"RightHand{_SOURCE[finger]}{FINGERTIP}" for finger in FINGERS]


@dataclass(frozen=True, eq=False)
class PosedHand:
    """Vertices (V, 3), the 16 joints and the 5 finger tips in the hand's own frame, metres."""

    vertices: np.ndarray
    joints: np.ndarray
    tips: np.ndarray


def in_hand_frame(vertices: np.ndarray, joints: np.ndarray, tips: np.ndarray) -> PosedHand:
    """Wrist at the origin, middle knuckle along -x, index to little knuckle along -z, back of the hand up."""
    along = joints[4] - joints[0]
    x = -along / np.linalg.norm(along)
    across = joints[1] - joints[7]
    z = across - (across @ x) * x
    z /= np.linalg.norm(z)
    R = np.stack([x, np.cross(z, x), z])
    return PosedHand(*((points - joints[0]) @ R.T for points in (vertices, joints, tips)))


def flattened(hand: PosedHand, weights: np.ndarray) -> PosedHand:
    """The hand with straight fingers in the plane of the palm: posed by its own skinning.

    Every finger keeps its natural spread: its bones are turned into the direction from knuckle to tip, laid
    into the plane. The thumb keeps its rest pose, beside the palm.
    """
    target = flattening_turns(hand)
    joints = np.zeros((16, 3))
    offsets = np.zeros((16, 3))
    for j in range(1, 16):
        parent = PARENTS[j]
        joints[j] = joints[parent] + target[parent] @ (hand.joints[j] - hand.joints[parent])
        offsets[j] = joints[j] - target[j] @ hand.joints[j]
    moved = np.einsum("vj,jab,vb->va", weights, target, hand.vertices) + weights @ offsets
    last = [3 * f + 3 for f in range(5)]
    tips = np.einsum("fab,fb->fa", target[last], hand.tips) + offsets[last]
    return PosedHand(moved, joints, tips)


def flattening_turns(hand: PosedHand) -> np.ndarray:
    """Rotation (16, 3, 3) in the hand's frame of every joint's bone to the flat hand."""
    target = np.tile(np.eye(3), (16, 1, 1))
    for f, finger in enumerate(FINGERS):
        if finger == "thumb":
            continue
        chain = np.vstack([hand.joints[3 * f + 1 : 3 * f + 4], hand.tips[f]])
        direction = (chain[3] - chain[0]) * [1, 0, 1]
        direction /= np.linalg.norm(direction)
        for k in range(3):
            bone = chain[k + 1] - chain[k]
            target[3 * f + 1 + k] = _shortest_turn(bone / np.linalg.norm(bone), direction)
    return target


def _shortest_turn(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    axis = np.cross(a, b)
    sine, cosine = np.linalg.norm(axis), a @ b
    return Rotation.from_rotvec(axis / max(sine, 1e-12) * np.arctan2(sine, cosine)).as_matrix()


def hand_weights(weights: np.ndarray, bones: tuple[str, ...], most: int = 4) -> np.ndarray:
    """Skinning weights (V, 16): bones merged, the rest of the body with the wrist, at most 4 per vertex."""
    index = {bone: i for i, bone in enumerate(bones)}
    merged = np.stack([weights[:, [index[b] for b in group]].sum(1) for group in bone_groups()], axis=1)
    merged[:, 0] += np.maximum(1 - merged.sum(1), 0)
    smallest = np.sort(merged, axis=1)[:, -most][:, None]
    kept = np.where(merged >= np.maximum(smallest, 1e-4), merged, 0)
    return kept / kept.sum(1, keepdims=True)


def joint_regressor(hands: list[PosedHand], weights: np.ndarray, neighbours: int = 80) -> np.ndarray:
    """Sparse, non-negative rows that sum to one and give the joints of all identities (SMPL's recipe)."""
    from scipy.optimize import nnls

    mean = np.mean([hand.vertices for hand in hands], axis=0)
    mean_joints = np.mean([hand.joints for hand in hands], axis=0)
    regressor = np.zeros((16, len(mean)))
    strict = 10.0  # weight of the row that asks for the sum of one
    # A little pull towards the mean of the ring: of the many regressors that fit the identities equally (held
    # out: 0.05 mm mean, 0.5 mm at most, with and without) it takes the one that noise moves half as much.
    even = 0.003
    for j in range(16):
        near = _ring(mean, mean_joints[j], weights, j, neighbours)
        A = np.concatenate([hand.vertices[near].T for hand in hands])
        b = np.concatenate([hand.joints[j] for hand in hands])
        A = np.vstack([A, np.full((1, len(near)), strict), even * np.eye(len(near))])
        solution, _ = nnls(A, np.concatenate([b, [strict], np.full(len(near), even / len(near))]))
        regressor[j, near] = solution / solution.sum()
    return regressor


def _ring(vertices: np.ndarray, joint: np.ndarray, weights: np.ndarray, j: int, count: int) -> np.ndarray:
    """Vertices round a joint that move with it or with its parent: not those of the next finger."""
    own = weights[:, j] + (weights[:, PARENTS[j]] if j else 0) > 0.3
    distance = np.where(own, np.linalg.norm(vertices - joint, axis=1), np.inf)
    return np.argsort(distance)[:count]
