"""Recorded body motion (CMU Graphics Lab Motion Capture Database, ASF and AMC files) on the body's 22 joints.

The recording's zero pose is not ours: legs 20 degrees apart, elbow axes 30 degrees off the vertical, feet at
the angle of a hanging foot. Every bone's orientation is compared with the one that it has at our zero pose,
so that equal limbs point in equal directions.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

JOINTS = (
    "pelvis", "left_hip", "right_hip", "spine1", "left_knee", "right_knee", "spine2", "left_ankle",
    "right_ankle", "spine3", "left_foot", "right_foot", "neck", "left_collar", "right_collar", "head",
    "left_shoulder", "right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist",
)  # fmt: skip
PARENTS = np.array([-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19])
# Clips that no statistics are made of: motion for tests.
TEST_CLIPS = ("01_14", "02_01", "02_03", "02_04", "02_10", "03_02")
_FPS = 120.0
_BONES = (
    "root", "lfemur", "rfemur", "lowerback", "ltibia", "rtibia", "upperback", "lfoot", "rfoot", "thorax",
    "ltoes", "rtoes", "lowerneck", "lclavicle", "rclavicle", "head", "lhumerus", "rhumerus", "lradius",
    "rradius", "lhand", "rhand",
)  # fmt: skip
_INCH = 0.0254
# Of a forearm's pronation the elbow has what the wrist's limits of 20 degrees leave to it.
_ELBOW_SHARE = 0.75
# The recordings' collar bones stay put. An arm that rises takes about a sixth of the way with the collar: as
# much is taken back from the T-pose, where it is lifted.
_COLLAR_SHARE = 1 / 6
# A foot stands where neither its ankle nor its toes move faster than this, metres per second.
_STANDING = 0.15
# Where standing ankles leave a plane by more than this (metres), it is no level ground but terrain; the slope
# of level ground is told by clips that go this far.
_LEVEL, _FAR = 0.01, 1.0
# Of all frames of a clip this share may reach below the ground.
_BELOW = 0.1


@dataclass(frozen=True, eq=False)
class MovedBody:
    """Whom the motion is carried over to.

    Attributes:
        joints: (22, 3) at the zero pose (T-pose, y up, z forward), metres, in the order of ``JOINTS``.
        soles: (n, 3) points under the feet at the zero pose.
        sole_joints: (n,) the joint (ankle or foot) that carries each.
    """

    joints: np.ndarray
    soles: np.ndarray
    sole_joints: np.ndarray

    @classmethod
    def of_surface(cls, joints: np.ndarray, vertices: np.ndarray, weights: np.ndarray) -> MovedBody:
        """From the surface at the zero pose (V, 3) and weights (V, at least 22): the lowest 15 mm of feet."""
        feet = np.flatnonzero(weights[:, [7, 8, 10, 11]].sum(1) > 0.9)
        low = feet[vertices[feet, 1] < vertices[feet, 1].min() + 0.015]
        return cls(
            joints[:22], vertices[low], np.array([7, 8, 10, 11])[weights[low][:, [7, 8, 10, 11]].argmax(1)]
        )


@dataclass(frozen=True, eq=False)
class Clip:
    """One recording on our joints.

    Attributes:
        name: subject and clip, for instance "02_01".
        pose: (T, 22, 3) axis-angle against the parent, the root first, radians.
        translation: (T, 3) metres, added after the root has turned about its rest joint; the ground is y = 0.
        fps: frames per second.
    """

    name: str
    pose: np.ndarray
    translation: np.ndarray
    fps: float

    def every(self, step: int) -> Clip:
        """Every ``step``-th frame."""
        return Clip(self.name, self.pose[::step], self.translation[::step], self.fps / step)


def recorded_clips(folder: Path, body: MovedBody, names: tuple[str, ...] | None = None) -> list[Clip]:
    """All clips of a folder of ``SS.asf`` and ``SS_NN.amc`` (or those named), carried over to a body."""
    clips = []
    for file in sorted(folder.glob("*.asf")):
        skeleton = _read_skeleton(file)
        motions = {path.stem: _read_motion(path) for path in sorted(folder.glob(f"{file.stem}_*.amc"))}
        turns = {name: _bone_turns(skeleton, motion) for name, motion in motions.items()}
        places = {name: _bone_places(skeleton, motions[name], turned) for name, turned in turns.items()}
        aligned = _alignments(skeleton, body, turns, places)
        slope = _slope_of_ground(places)
        for place in places.values():
            for ends in place.values():
                ends[:, 1] -= ends[:, [0, 2]] @ slope
        clips += [
            _carried_over(name, turns[name], places[name], aligned, body)
            for name in motions
            if names is None or name in names
        ]
    return clips


@dataclass(frozen=True, eq=False)
class _Skeleton:
    """Bones by name: parent, step from the parent's end to the own (metres), frame of its angles, angles."""

    parents: dict[str, str]
    steps: dict[str, np.ndarray]
    frames: dict[str, np.ndarray]
    angles: dict[str, tuple[str, ...]]


def _read_skeleton(path: Path) -> _Skeleton:
    unit, bone = _INCH, ""
    steps, frames, angles = {"root": np.zeros(3)}, {"root": np.eye(3)}, {"root": ("rx", "ry", "rz")}
    parents: dict[str, str] = {}
    for words in (line.split() for line in path.read_text().splitlines()):
        match words:
            case ["length", value] if not bone:
                unit = _INCH / float(value)
            case ["name", name]:
                bone = name
                angles[bone] = ()
            case ["direction", *xyz]:
                steps[bone] = np.array(xyz, dtype=float)
            case ["length", value]:
                steps[bone] *= unit * float(value)
            case ["axis", *xyz, "XYZ"] if bone:
                frames[bone] = _turned(np.array(xyz, dtype=float))
            case ["dof", *names]:
                angles[bone] = tuple(names)
            case [parent, *children] if parent in steps and all(child in steps for child in children):
                parents |= dict.fromkeys(children, parent)
    steps["unit"] = np.array([unit])
    return _Skeleton(parents, steps, frames, angles)


def _turned(degrees: np.ndarray) -> np.ndarray:
    """Turns about x, then y, then z, axes fixed: (..., 3) to (..., 3, 3)."""
    flat = Rotation.from_euler("xyz", degrees.reshape(-1, 3), degrees=True).as_matrix()
    return flat.reshape(*degrees.shape[:-1], 3, 3)


def _read_motion(path: Path) -> dict[str, np.ndarray]:
    """Numbers (T, n) of every bone."""
    rows: dict[str, list[list[float]]] = {}
    for words in (line.split() for line in path.read_text().splitlines()):
        if len(words) > 1 and words[0][0].isalpha():
            rows.setdefault(words[0], []).append([float(word) for word in words[1:]])
    return {bone: np.array(values) for bone, values in rows.items()}


def _bone_turns(skeleton: _Skeleton, motion: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Orientation (T, 3, 3) of every bone in the world, against its zero pose."""
    turns = {"root": _turned(motion["root"][:, 3:])}
    for bone, parent in skeleton.parents.items():
        turns[bone] = turns[parent]
        if skeleton.angles[bone]:
            degrees = np.zeros((len(motion["root"]), 3))
            degrees[:, ["xyz".index(angle[1]) for angle in skeleton.angles[bone]]] = motion[bone]
            frame = skeleton.frames[bone]
            turns[bone] = turns[parent] @ frame @ _turned(degrees) @ frame.T
    return turns


def _bone_places(
    skeleton: _Skeleton, motion: dict[str, np.ndarray], turns: dict[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Where every bone ends (T, 3), metres."""
    places = {"root": skeleton.steps["unit"] * motion["root"][:, :3]}
    for bone, parent in skeleton.parents.items():
        places[bone] = places[parent] + turns[bone] @ skeleton.steps[bone]
    return places


def _alignments(
    skeleton: _Skeleton, body: MovedBody, turns: dict[str, dict[str, np.ndarray]],
    places: dict[str, dict[str, np.ndarray]],
) -> np.ndarray:  # fmt: skip
    """(22, 3, 3) rotation that takes our bones at our zero pose to the recording's at its own."""
    aligned = np.tile(np.eye(3), (22, 1, 1))
    joints, lateral = body.joints, np.array([1.0, 0, 0])
    for left in (0, 1):
        hip, knee, ankle, foot = (joint + left for joint in (1, 4, 7, 10))
        side = "lr"[left]
        axis = skeleton.frames[f"{side}tibia"][:, 0]
        for joint, end, bone in ((hip, knee, "femur"), (knee, ankle, "tibia")):
            ours = _frame(joints[end] - joints[joint], lateral)
            aligned[joint] = _frame(skeleton.steps[side + bone], axis) @ ours.T
        for joint, bone in ((ankle, "foot"), (foot, "toes")):
            # How a foot hangs at the recording's zero pose says nothing: it is level where it stands.
            up = _level(side + bone, side, turns, places)
            ahead = joints[foot] - joints[ankle]
            aligned[joint] = _frame(up, skeleton.steps[side + bone]) @ _frame(np.array([0.0, 1, 0]), ahead).T
        # Elbows bend about the vertical in our zero pose.
        shoulder, elbow = 16 + left, 18 + left
        along, upright = joints[elbow] - joints[shoulder], np.array([0, 2.0 * left - 1, 0])
        bent = skeleton.frames[f"{side}radius"][:, 0]
        aligned[shoulder] = _frame(skeleton.steps[f"{side}humerus"], bent) @ _frame(along, upright).T
        aligned[elbow] = aligned[shoulder]
    return aligned


def _frame(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Columns: first; what of second stands upright on it; their cross product."""
    first = first / np.linalg.norm(first)
    second = second - (second @ first) * first
    second = second / np.linalg.norm(second)
    return np.stack([first, second, np.cross(first, second)], axis=1)


def _level(
    bone: str, side: str, turns: dict[str, dict[str, np.ndarray]], places: dict[str, dict[str, np.ndarray]]
) -> np.ndarray:
    """What is up in a bone of the foot at the recording's zero pose: median over standing frames."""
    ups = []
    for name, place in places.items():
        ups.append(turns[name][bone][_stands(place, side)][:, 1])
    up = np.median(np.concatenate(ups), axis=0)
    return up / np.linalg.norm(up)


def _stands(place: dict[str, np.ndarray], side: str) -> np.ndarray:
    ends = [place[f"{side}tibia"], place[f"{side}foot"]]
    speed = np.max([np.linalg.norm(np.gradient(end, axis=0), axis=1) for end in ends], axis=0)
    return _FPS * speed < _STANDING


def _slope_of_ground(places: dict[str, dict[str, np.ndarray]]) -> np.ndarray:
    """(2,) rise per metre along x and z, in which a subject's recordings of level ground agree."""
    slopes: tuple[list[float], list[float]] = ([], [])
    for place in places.values():
        ankles = np.concatenate([place[f"{side}tibia"][_stands(place, side)] for side in "lr"])
        if len(ankles) < 50:
            continue
        columns = np.c_[np.ones(len(ankles)), ankles[:, [0, 2]]]
        plane, *_ = np.linalg.lstsq(columns, ankles[:, 1], rcond=None)
        if np.std(ankles[:, 1] - columns @ plane) > _LEVEL:
            continue
        for axis in (0, 1):
            if np.ptp(columns[:, 1 + axis]) > _FAR:
                slopes[axis].append(plane[1 + axis])
    return np.array([np.median(found) if found else 0.0 for found in slopes])


def _carried_over(
    name: str,
    turns: dict[str, np.ndarray],
    places: dict[str, np.ndarray],
    aligned: np.ndarray,
    body: MovedBody,
) -> Clip:
    world = np.stack([turns[bone] for bone in _BONES], axis=1) @ aligned
    for side in (0, 1):
        _lift_collar(world, side)
        _share_pronation(world, side)
    # Neck and head turn equally: the markers do not tell the neck's two bones apart, which often oppose.
    half = Rotation.from_matrix(np.swapaxes(world[:, 9], 1, 2) @ world[:, 15]).as_rotvec() / 2
    world[:, 12] = world[:, 9] @ Rotation.from_rotvec(half).as_matrix()
    local = world.copy()
    local[:, 1:] = np.swapaxes(world[:, PARENTS[1:]], 2, 3) @ world[:, 1:]
    pose = Rotation.from_matrix(local.reshape(-1, 3, 3)).as_rotvec().reshape(-1, 22, 3)
    return Clip(name, pose, _translation(places, world, body), _FPS)


def _lift_collar(world: np.ndarray, side: int) -> None:
    parent, collar, shoulder = 9, 13 + side, 16 + side
    outward = np.array([1.0 - 2 * side, 0, 0])
    arm = np.einsum("tba,tbc,c->ta", world[:, parent], world[:, shoulder], outward)
    lift = _COLLAR_SHARE * np.arcsin(np.clip(arm[:, 1], -1, 1)) * outward[0]
    turn = Rotation.from_rotvec(lift[:, None] * np.array([0.0, 0, 1])).as_matrix()
    world[:, collar] = world[:, parent] @ turn


def _share_pronation(world: np.ndarray, side: int) -> None:
    """The recording turns the hand alone about the forearm; we the forearm too."""
    elbow, wrist = 18 + side, 20 + side
    turn = Rotation.from_matrix(np.swapaxes(world[:, elbow], 1, 2) @ world[:, wrist]).as_quat()
    twist = 2 * np.arctan2(turn[:, 0], turn[:, 3])
    twist = _ELBOW_SHARE * ((twist + np.pi) % (2 * np.pi) - np.pi)
    world[:, elbow] = world[:, elbow] @ Rotation.from_rotvec(twist[:, None] * np.eye(3)[:1]).as_matrix()


def _translation(places: dict[str, np.ndarray], world: np.ndarray, body: MovedBody) -> np.ndarray:
    """Steps as long as the legs are; hips above hips; the ground where the feet stand."""
    joints = body.joints
    own = sum(np.linalg.norm(joints[a] - joints[b]) for a, b in ((1, 4), (4, 7)))
    theirs = sum(
        np.linalg.norm(places[a][0] - places[b][0])
        for a, b in (("lhipjoint", "lfemur"), ("lfemur", "ltibia"))
    )
    hips = own / theirs * (places["lhipjoint"] + places["rhipjoint"]) / 2
    from_pelvis = (joints[1] + joints[2]) / 2 - joints[0]
    translation = hips - world[:, 0] @ from_pelvis - joints[0]
    placed = np.tile(joints[0], (len(hips), 22, 1)) + translation[:, None]
    for joint in range(1, 22):
        parent = PARENTS[joint]
        placed[:, joint] = placed[:, parent] + world[:, parent] @ (joints[joint] - joints[parent])
    offsets = body.soles - joints[body.sole_joints]
    heights = np.einsum("tsb,sb->ts", world[:, body.sole_joints, 1], offsets) + placed[:, body.sole_joints, 1]
    translation[:, 1] -= np.quantile(heights.min(1), _BELOW)
    return translation
