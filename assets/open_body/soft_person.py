"""The open body as a soft body: rigid bones inside flesh that settles by statics.

Limbs hold a rod from joint to joint, the trunk a core of what lies deep under the skin (pelvis, rib cage,
shoulder blades); hands and head are rigid altogether, since their correctives are not learned here. Where a
bone ends in a joint a ball turns by half. The forearm's rod twists along its length, as radius and ulna do.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from corporeal.geometry.rotations_numeric import matrix_from_axis_angle
from corporeal.model.surface_model import SurfaceModel
from corporeal.scans.simulation.bone_rods import hinge_motions, to_segment
from corporeal.scans.simulation.embedded_skin import EmbeddedSkin
from corporeal.scans.simulation.soft_body import FleshOptions, PosedFlesh, SoftBody
from corporeal.scans.simulation.tetrahedra import edge_matrices

TETRAHEDRA = Path(__file__).with_name("tetrahedra.npz")
# A hand's contact, five times as large. Arm and trunk, thigh and belly grow together nearer than part_gap.
FLESH = FleshOptions(
    thickness=1e-3, contact=4.0, rest_gap=60e-3, part_gap=45e-3, reach=30e-3, increments=4, iterations=120,
    tolerance=0.15e-3,
)  # fmt: skip
# Bones as rods from joint to joint, with their radius as a share of the way from the axis to the skin.
_RODS = {
    3: (6, 0.3), 6: (9, 0.3), 12: (15, 0.35), 13: (16, 0.3), 14: (17, 0.3), 16: (18, 0.42), 17: (19, 0.42),
    18: (20, 0.5), 19: (21, 0.5), 1: (4, 0.38), 2: (5, 0.38), 4: (7, 0.5), 5: (8, 0.5),
}  # fmt: skip
# Held as far as this joint moves the flesh by more than a share, deeper under the skin than so many metres.
_CORES = {
    0: (0.6, 0.030), 9: (0.55, 0.025), 13: (0.6, 0.025), 14: (0.6, 0.025), 7: (0.8, 0.008), 8: (0.8, 0.008),
    10: (0.8, 0.003), 11: (0.8, 0.003),
}  # fmt: skip
# Rigid to the skin: hands and head with all that hangs on them.
_WHOLE = {20: (20, *range(25, 40)), 21: (21, *range(40, 55)), 15: (15, 22, 23, 24)}
_WHOLE_SHARE = 0.97
_HINGES = (1, 2, 3, 4, 5, 6, 7, 8, 9, 12, 15, 16, 17, 18, 19, 20, 21)
# Of the way from the joint to the skin. A rod is a cone at its ends, with this slope: two that meet at 45
# degrees just miss each other.
_HINGE_SHARE, _SLOPE = 0.45, 0.4
# Pieces of a forearm, each with its share of the elbow's twist.
_FOREARMS, _PIECES = (18, 19), 4
# Joints whose skin meets as one part: trunk with head, arms, legs.
_PARTS = ((0, 3, 6, 9, 12, 13, 14, 15), (16, 18, 20), (17, 19, 21), (1, 4, 7, 10), (2, 5, 8, 11))
# A pose is relaxed by a share and tried again where more elements than this are inverted in the depth of a
# crease, or skin stands deeper in skin, metres.
_TRIES, _RELAXED, _INVERTED, _DEEPEST = 4, 0.88, 6, 10e-3


@dataclass(frozen=True, eq=False)
class SettledPerson:
    """A settled body.

    Attributes:
        surface: (V, 3) metres, the root's translation zero.
        pose: (55, 3) axis-angle that was reached: a share of the one asked for where flesh had no room.
        flesh: what the solver says of it.
    """

    surface: np.ndarray
    pose: np.ndarray
    flesh: PosedFlesh


class SoftPerson:
    """A person whose skin has the open body's topology.

    Attributes:
        surface: (V, 3) skin at the zero pose, metres.
        joints: (55, 3) metres.
        body: the flesh.
        fixed: (T,) the bone, hinge or piece that a vertex of the tetrahedra is held by, -1 for flesh.
    """

    def __init__(self, model: SurfaceModel, surface: np.ndarray, options: FleshOptions = FLESH) -> None:
        """Carry the tetrahedra over to a person and find the bones in them.

        Raises:
            ValueError: the person is so unlike the template that an element is inverted at rest.
        """
        self.surface, self.parents = surface, np.asarray(model.parents)
        self.joints = np.asarray(model.joint_regressor @ surface)
        self._skin = _embedded(model)
        self.rest = self._skin.rest_of(surface)
        weights = self._skin.weights(rigid_weights(model.skinning_weights))
        self.fixed = self._fixed(weights)
        extra = np.zeros((len(weights), len(_HINGES) + len(_FOREARMS) * _PIECES))
        part = np.array([weights[:, list(joints)].sum(1) for joints in _PARTS]).argmax(0)
        self.body = SoftBody(
            self.rest, self._skin.tets, np.hstack([weights, extra]), self.fixed, part, options
        )

    def posed(self, pose: np.ndarray) -> SettledPerson:
        """Settle the flesh at a pose (55, 3), axis-angle in radians, zero for fingers, jaw and eyes."""
        share = 1.0
        for _ in range(_TRIES):
            steps = share * np.arange(1, self.body.options.increments + 1) / self.body.options.increments
            flesh = self.body.posed(np.array([self._motions(step * pose) for step in steps]))
            if self._inverted(flesh.vertices) <= _INVERTED and flesh.deepest < _DEEPEST:
                break
            share *= _RELAXED
        return SettledPerson(self._skin.posed(self.surface, self.rest, flesh.vertices), share * pose, flesh)

    def _inverted(self, vertices: np.ndarray) -> int:
        """How many elements are inverted that no bone holds.

        One squashed between two bones in a joint is inverted now and then, which skin does not feel.
        """
        flesh = self._skin.tets[(self.fixed[self._skin.tets] < 0).all(1)]
        return int((np.linalg.det(edge_matrices(vertices, flesh)) <= 0).sum())

    def _motions(self, pose: np.ndarray) -> np.ndarray:
        """Of joints, then of hinges, then of the pieces of the forearms."""
        motions = bone_motions(self.joints, self.parents, pose)
        halves = hinge_motions(motions, self.joints, self.parents, _HINGES)
        pieces = []
        for bone in _FOREARMS:
            parent = motions[self.parents[bone]]
            turn = Rotation.from_matrix(parent[:3, :3].T @ motions[bone, :3, :3])
            axis = self.joints[bone + 2] - self.joints[bone]
            untwisted = _twist(turn, axis / np.linalg.norm(axis)).inv()
            for k in range(_PIECES):
                left = Rotation.from_rotvec((1 - (k + 0.5) / _PIECES) * untwisted.as_rotvec()).as_matrix()
                turned = np.eye(4)
                turned[:3, :3], turned[:3, 3] = left, self.joints[bone] - left @ self.joints[bone]
                pieces.append(motions[bone] @ turned)
        return np.concatenate([motions, halves, pieces])

    def _fixed(self, weights: np.ndarray) -> np.ndarray:
        fixed = np.full(len(weights), -1)
        depth, _ = cKDTree(self.surface).query(self.rest)
        for bone, joints in _WHOLE.items():
            fixed[weights[:, list(joints)].sum(1) > _WHOLE_SHARE] = bone
        for bone, (share, least) in _CORES.items():
            fixed[(fixed < 0) & (weights[:, bone] > share) & (depth > least)] = bone
        to_skin = cKDTree(self.surface)
        for bone, (end, share) in _RODS.items():
            head, tail = self.joints[bone], self.joints[end]
            distance, along = to_segment(self.rest, head, tail)
            middle = head + np.linspace(0.3, 0.7, 5)[:, None] * (tail - head)
            radius = share * np.median(to_skin.query(middle)[0])
            to_end = np.minimum(along, 1 - along) * np.linalg.norm(tail - head)
            inside = (distance < np.minimum(radius, _SLOPE * to_end)) & (fixed < 0)
            if bone in _FOREARMS:
                piece = np.clip((along * _PIECES).astype(int), 0, _PIECES - 1)
                first = 55 + len(_HINGES) + _FOREARMS.index(bone) * _PIECES
                fixed[inside] = first + piece[inside]
            else:
                fixed[inside] = bone
        for h, bone in enumerate(_HINGES):
            size = _HINGE_SHARE * to_skin.query(self.joints[bone])[0]
            near = np.linalg.norm(self.rest - self.joints[bone], axis=1) < size
            fixed[near & (fixed < 0)] = 55 + h
        return fixed


def bone_motions(joints: np.ndarray, parents: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """(55, 4, 4) motion of every joint from rest, chained down the tree."""
    motions = np.tile(np.eye(4), (len(joints), 1, 1))
    motions[:, :3, :3] = matrix_from_axis_angle(pose)
    motions[:, :3, 3] = joints - np.einsum("kab,kb->ka", motions[:, :3, :3], joints)
    for joint in range(1, len(joints)):
        motions[joint] = motions[parents[joint]] @ motions[joint]
    return motions


def _twist(turn: Rotation, axis: np.ndarray) -> Rotation:
    """The part of a turn about an axis."""
    quaternion = turn.as_quat()
    return Rotation.from_quat(np.append((quaternion[:3] @ axis) * axis, quaternion[3]))


def rigid_weights(weights: np.ndarray) -> np.ndarray:
    """Fingers with their wrist, face with the head: they do not move here."""
    gathered = weights.astype(np.float64).copy()
    for bone, joints in _WHOLE.items():
        gathered[:, bone] = weights[:, list(joints)].sum(1)
        gathered[:, list(joints[1:])] = 0
    return gathered


def template_digest(model: SurfaceModel) -> str:
    """What says that tetrahedra are of this template, to a tenth of a micrometre."""
    return hashlib.sha256(np.round(1e7 * model.template).astype(np.int64).tobytes()).hexdigest()


@lru_cache(maxsize=1)
def _embedded(model: SurfaceModel) -> EmbeddedSkin:
    with np.load(TETRAHEDRA) as arrays:
        if str(arrays["template_sha256"]) != template_digest(model):
            raise SystemExit(f"{TETRAHEDRA.name}: of another template; run assets/tetrahedralise_body.py")
        vertices, tets = arrays["tet_vertices"].astype(np.float64), arrays["tets"].astype(np.int64)
    return EmbeddedSkin(model.template, vertices, tets)
