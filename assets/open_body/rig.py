"""From the source's bones to SMPL-X's 55 joints, and from its relaxed stance to the T-pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from open_hand.rig import FINGERS, PosedHand, bone_groups, flattened, in_hand_frame, tip_bones
from scipy.spatial.transform import Rotation

from .symmetry import MIRROR, mirrored

_BODY = {
    "pelvis": (-1, ["Hips", "Root"]),
    "left_hip": (0, ["LeftLeg"]), "right_hip": (0, ["RightLeg"]), "spine1": (0, ["Spine1"]),
    "left_knee": (1, ["LeftShin"]), "right_knee": (2, ["RightShin"]), "spine2": (3, ["Spine2"]),
    "left_ankle": (4, ["LeftFoot"]), "right_ankle": (5, ["RightFoot"]), "spine3": (6, ["Chest"]),
    "left_foot": (7, ["LeftToeBase", "LeftToeEnd"]), "right_foot": (8, ["RightToeBase", "RightToeEnd"]),
    "neck": (9, ["Neck1", "Neck2"]), "left_collar": (9, ["LeftShoulder"]),
    "right_collar": (9, ["RightShoulder"]),
    "head": (12, ["Head", "HeadEnd"]), "left_shoulder": (13, ["LeftArm"]),
    "right_shoulder": (14, ["RightArm"]),
    "left_elbow": (16, ["LeftForeArm"]), "right_elbow": (17, ["RightForeArm"]),
    "left_wrist": (18, []), "right_wrist": (19, []),
    "jaw": (15, ["Jaw"]), "left_eye_smplhf": (15, ["LeftEye"]), "right_eye_smplhf": (15, ["RightEye"]),
}  # fmt: skip
_FINGER_JOINTS = [f"{finger}{k}" for finger in FINGERS for k in (1, 2, 3)]
JOINT_NAMES = (*_BODY, *(f"{side}_{name}" for side in ("left", "right") for name in _FINGER_JOINTS))
PARENTS = np.array(
    [parent for parent, _ in _BODY.values()]
    + [wrist if k % 3 == 0 else first + k - 1 for wrist, first in ((20, 25), (21, 40)) for k in range(15)]
)
RIGHT_HAND = (21, *range(40, 55))
LEFT_HAND = (20, *range(25, 40))
# Where along the wrist (x in the hand's frame, metres) the surface is wholly the body's, wholly the hand's.
_ALL_BODY, _ALL_HAND = 0.021, -0.008
# Raising the arm from the source's 48 degrees to the horizontal lifts the collar bone too: about a sixth.
_COLLAR_LIFT = np.deg2rad(8.0)


def joint_groups() -> list[list[str]]:
    """Source bones of every joint, the bone whose head is the joint first."""
    groups = [list(bones) for _, bones in _BODY.values()] + [[]] * 30
    for joint, group in zip(RIGHT_HAND, bone_groups(), strict=True):
        groups[joint] = group
    for joint, group in zip(LEFT_HAND, bone_groups(), strict=True):
        groups[joint] = [bone.replace("Right", "Left") for bone in group]
    return groups


def mirror_joints() -> np.ndarray:
    """(55,) index of the joint on the other side."""
    swap = {"left": "right", "right": "left"}
    other = []
    for name in JOINT_NAMES:
        side, _, rest = name.partition("_")
        other.append(JOINT_NAMES.index(f"{swap[side]}_{rest}" if side in swap else name))
    return np.array(other)


@dataclass(frozen=True, eq=False)
class Stance:
    """One person: vertices (V, 3), the 55 joints, and the tips of the right hand's fingers (5, 3), metres."""

    vertices: np.ndarray
    joints: np.ndarray
    tips: np.ndarray


def stance_of(vertices: np.ndarray, heads: np.ndarray, bones: tuple[str, ...], mirror: np.ndarray) -> Stance:
    """Made symmetric: the mean of the person and their mirror image."""
    index = {bone: i for i, bone in enumerate(bones)}
    joints = heads[[index[group[0]] for group in joint_groups()]]
    tips = heads[[index[bone] for bone in tip_bones()]]
    return Stance(
        (vertices + mirrored(vertices, mirror)) / 2, (joints + mirrored(joints, mirror_joints())) / 2, tips
    )


def t_pose(
    stance: Stance, weights: np.ndarray, hand_vertices: np.ndarray, hand_weights: np.ndarray
) -> tuple[Stance, PosedHand]:
    """The person with arms out sideways, palms down and flat hands, the pelvis at the origin.

    The body is posed with dual quaternions (blending matrices over the 48 degrees of the arms folds the
    armpits), the right hand exactly as the open hand is, by ``hand_vertices`` and their own 16 weights; it
    is returned beside the body, in its own frame.
    """
    turns, hand = turns_to_t_pose(stance, hand_vertices, hand_weights)
    joints = np.zeros_like(stance.joints)
    for j in range(1, 55):
        parent = PARENTS[j]
        joints[j] = joints[parent] + turns[parent] @ (stance.joints[j] - stance.joints[parent])
    vertices = _dual_quaternion_skinned(stance.vertices, stance.joints, joints, turns, weights)
    joints[list(RIGHT_HAND)] = joints[21] + hand.joints
    joints[list(LEFT_HAND)] = joints[20] + hand.joints * MIRROR
    return Stance(vertices, joints, joints[21] + hand.tips), hand


def with_hands(
    vertices: np.ndarray, joints: np.ndarray, hand: np.ndarray, hand_vertices: np.ndarray, mirror: np.ndarray
) -> np.ndarray:
    """The body's surface with a hand's own (V_hand, 3) at both wrists, faded in behind the wrist."""
    # All hand from 8 mm beyond the wrist joint on, all body at the loop (21 to 37 mm behind it). The T-pose's
    # forearm leaves the hand at another angle than the cut hand's stump: over 12 mm there was a step.
    share = np.clip((_ALL_BODY - hand[:, 0]) / (_ALL_BODY - _ALL_HAND), 0, 1)[:, None]
    share = share * share * (3 - 2 * share)
    joined = vertices.copy()
    joined[hand_vertices] = (1 - share) * vertices[hand_vertices] + share * (hand + joints[21])
    joined[mirror[hand_vertices]] = joined[hand_vertices] * MIRROR
    return joined


def turns_to_t_pose(
    stance: Stance, hand_vertices: np.ndarray, hand_weights: np.ndarray
) -> tuple[np.ndarray, PosedHand]:
    """Rotation (55, 3, 3) of every joint into the T-pose, and the right hand in its own frame."""
    joints = stance.joints
    turns = np.tile(np.eye(3), (55, 1, 1))
    rest = in_hand_frame(stance.vertices[hand_vertices], joints[list(RIGHT_HAND)], stance.tips)
    hand = flattened(rest, hand_weights)
    outward = np.array([-1.0, 0, 0])
    collar = Rotation.from_rotvec([0, 0, -_COLLAR_LIFT]).as_matrix()
    upper, fore = joints[19] - joints[17], joints[21] - joints[19]
    # The elbow's axis stands upright in the T-pose: bending brings the hand forward.
    shoulder = _frame(outward, np.array([0.0, 1, 0])) @ _frame(upper, np.cross(upper, fore)).T
    elbow = _frame(outward, np.array([0.0, 1, 0])) @ _frame(fore, np.cross(upper, fore)).T
    wrist = _hand_turn(joints)
    # Half of what is left of the turn about the forearm's axis is the forearm's own: it pronates.
    twist = _twist(wrist @ elbow.T, outward)
    elbow = Rotation.from_rotvec(0.5 * twist * outward).as_matrix() @ elbow
    right = {14: collar, 17: shoulder, 19: elbow, 21: wrist} | dict.fromkeys(range(40, 55), wrist)
    other = mirror_joints()
    for joint, turn in right.items():
        turns[joint] = turn
        turns[other[joint]] = turn * np.outer(MIRROR, MIRROR)
    return turns, hand


def _hand_turn(joints: np.ndarray) -> np.ndarray:
    """Rotation into the hand's own frame, as ``in_hand_frame`` finds it."""
    basis = in_hand_frame(joints[21] + np.eye(3), joints[list(RIGHT_HAND)], joints[:5])
    return basis.vertices.T


def _frame(along: np.ndarray, axis: np.ndarray) -> np.ndarray:
    along = along / np.linalg.norm(along)
    axis = axis - (axis @ along) * along
    axis = axis / np.linalg.norm(axis)
    return np.stack([along, axis, np.cross(along, axis)], axis=1)


def _twist(turn: np.ndarray, axis: np.ndarray) -> float:
    x, y, z, w = Rotation.from_matrix(turn).as_quat()
    angle = 2 * np.arctan2(np.array([x, y, z]) @ axis, w)
    return float((angle + np.pi) % (2 * np.pi) - np.pi)


def _dual_quaternion_skinned(
    vertices: np.ndarray, joints: np.ndarray, moved: np.ndarray, turns: np.ndarray, weights: np.ndarray
) -> np.ndarray:
    """Kavan et al. 2007: screws blended as unit dual quaternions."""
    real = Rotation.from_matrix(turns).as_quat()
    real = real * np.sign(real[:, 3:] + 1e-12)
    shift = moved - np.einsum("jab,jb->ja", turns, joints)
    dual = 0.5 * _quaternion_product(np.concatenate([shift, np.zeros((len(shift), 1))], 1), real)
    a, b = weights @ real, weights @ dual
    length = np.linalg.norm(a, axis=1, keepdims=True)
    a, b = a / length, b / length
    conjugate = a * [-1, -1, -1, 1]
    return Rotation.from_quat(a).apply(vertices) + 2 * _quaternion_product(b, conjugate)[:, :3]


def _quaternion_product(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """(x, y, z, w) each."""
    vector = p[:, 3:] * q[:, :3] + q[:, 3:] * p[:, :3] + np.cross(p[:, :3], q[:, :3])
    return np.concatenate([vector, p[:, 3:] * q[:, 3:] - np.sum(p[:, :3] * q[:, :3], 1, keepdims=True)], 1)
