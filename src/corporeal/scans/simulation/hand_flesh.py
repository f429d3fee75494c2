"""One person's soft hand: where the bones lie in the flesh, and how skin follows the tetrahedra."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int

from corporeal.scans.simulation.bone_rods import hinge_motions, to_segment
from corporeal.scans.simulation.embedded_skin import EmbeddedSkin
from corporeal.scans.simulation.files import HandSimulator
from corporeal.scans.simulation.skeleton import bone_transforms
from corporeal.scans.simulation.soft_body import FleshOptions, PosedFlesh, SoftBody

HAND = 1
# Bones fill this share of the way from their axis to the skin.
_BONE_SHARE = 0.45
# Where bones end before a joint, in their own radius: at 90 degrees two round ends just miss each other.
_CLEARANCE = 1.25
_JOINT_SHARE = 0.6
_END_CAP = 4e-3


@dataclass(frozen=True, eq=False)
class PosedHand:
    """A settled hand.

    Attributes:
        surface: (N, 3) the simulator's surface vertices, metres.
        motions: (17, 4, 4) motion of every bone from rest.
        flesh: what the solver says of it.
        pose_share: how much of the pose was reached: less than 1 where fingers would have had to pass through
            one another.
    """

    surface: Float[np.ndarray, "N 3"]
    motions: Float[np.ndarray, "17 4 4"]
    flesh: PosedFlesh
    pose_share: float


class SoftHand:
    """A person's right hand (or the mirror image of the left one) that can be posed.

    Attributes:
        joints: (22, 3) bones' heads and tips at rest, metres.
        rest_surface: (N, 3) skin at rest, metres.
        rest_tets: (T, 3) vertices of the tetrahedra at rest, metres.
        body: the flesh.
    """

    def __init__(
        self,
        simulator: HandSimulator,
        surface: Float[np.ndarray, "N 3"],
        joints: Float[np.ndarray, "22 3"],
        options: FleshOptions | None = None,
    ) -> None:
        """Carry the tetrahedra over to a person and find the bones in them.

        Args:
            simulator: the base hand.
            surface: skin of the person at rest, metres.
            joints: heads of the bones, then finger tips, metres.
            options: flesh.

        Raises:
            ValueError: the person is so unlike the base hand that an element is inverted at rest.
        """
        self._simulator = simulator
        self.joints = joints
        self.rest_tets = _embedded(simulator).rest_of(surface)
        self.rest_surface = surface
        weights = _tet_weights(simulator)
        fixed = _fixed_bones(self.rest_tets, weights, surface, simulator.weights, joints, simulator.parents)
        part = _PART_OF_BONE[weights.argmax(1)]
        extra = np.zeros((len(weights), len(_HINGES)))
        self.body = SoftBody(
            self.rest_tets, simulator.tets, np.hstack([weights, extra]), fixed, part, options
        )

    def posed(self, angles: Float[np.ndarray, "17 3"]) -> PosedHand:
        """Settle the flesh at a pose.

        Args:
            angles: degrees, absolute: flexion, spread and twist of every bone against the flat hand.
        """
        rest = self._simulator.rest_angles
        share = 1.0
        for _ in range(_TRIES):
            count = self.body.options.increments
            motions = [self._motions(rest + s * (angles - rest)) for s in _schedule(count, share)]
            flesh = self.body.posed(np.array(motions))
            if flesh.smallest_det > 0 and flesh.deepest < _DEEPEST:
                break
            share *= _RELAXED
        return PosedHand(self._skin(flesh.vertices), motions[-1][: len(rest)], flesh, share)

    def skinned(self, angles: Float[np.ndarray, "17 3"]) -> Float[np.ndarray, "N 3"]:
        """Linear skinning of the same surface with the base hand's weights, metres."""
        motions = bone_transforms(self._simulator, self.joints, angles)
        blended = np.einsum("vk,kab->vab", self._simulator.weights, motions[:, :3])
        return np.einsum("vab,vb->va", blended[:, :, :3], self.rest_surface) + blended[:, :, 3]

    def _motions(self, angles: np.ndarray) -> np.ndarray:
        """Bones, then the ends of bones in the joints, which turn half as far as the bone that follows."""
        motions = bone_transforms(self._simulator, self.joints, angles)
        halves = hinge_motions(motions, self.joints, self._simulator.parents, _HINGES)
        return np.concatenate([motions, halves])

    def _skin(self, vertices: np.ndarray) -> np.ndarray:
        """Skin in the posed tetrahedra."""
        return _embedded(self._simulator).posed(self.rest_surface, self.rest_tets, vertices)


# Index, middle, little, ring and thumb hold three bones each behind forearm and hand.
_PART_OF_BONE = np.concatenate([[0, 0], np.repeat(np.arange(1, 6), 3)])
_HINGES = tuple(range(2, 17))
_PALM_ENDS = (2, 5, 8, 11)
_THUMB, _THUMB_LAG = 5, 3
_TRIES, _RELAXED, _DEEPEST = 8, 0.87, 1e-3


def _schedule(count: int, share: float) -> list[Float[np.ndarray, "17 1"]]:
    """Share of the pose that every bone has reached, step by step.

    The thumb follows the fingers: one that arrives with them is caught beneath them.
    """
    steps = np.arange(1, count + 1) / count
    thumb = (_PART_OF_BONE == _THUMB)[:, None]
    return [share * np.where(thumb, step**_THUMB_LAG, step) for step in steps]


def bone_segments(
    joints: Float[np.ndarray, "22 3"],
) -> tuple[Float[np.ndarray, "s 2 3"], Int[np.ndarray, " s"]]:
    """Axes of the bones, from head to end, and the bone that each belongs to; the hand has four."""
    segments, bones = [(joints[0], joints[HAND])], [0]
    for end in _PALM_ENDS:
        segments.append((joints[HAND], joints[end]))
        bones.append(HAND)
    for finger in range(5):
        first = 2 + 3 * finger
        ends = [joints[first + 1], joints[first + 2], joints[17 + finger]]
        for k, end in enumerate(ends):
            segments.append((joints[first + k], end))
            bones.append(first + k)
    return np.array(segments), np.array(bones)


def _fixed_bones(
    vertices: np.ndarray, weights: np.ndarray, surface: np.ndarray, surface_weights: np.ndarray,
    joints: np.ndarray, parents: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """The bone or hinge that every vertex is fixed to, -1 for flesh."""
    fixed = np.full(len(vertices), -1)
    segments, bones = bone_segments(joints)
    own, radius = surface_weights.argmax(1), np.zeros(17)
    for bone in np.unique(bones):
        axes = segments[bones == bone]
        skin = surface[own == bone]
        distance = np.min([to_segment(skin, *axis)[0] for axis in axes], axis=0)
        radius[bone] = _BONE_SHARE * np.median(distance)
    for (head, end), bone in zip(segments, bones, strict=True):
        distance, along = to_segment(vertices, head, end)
        length = np.linalg.norm(end - head)
        margin = _CLEARANCE * radius[bone] / length
        # The forearm is cut: it has no end there. The hand's bones begin at the wrist without a gap.
        low = -np.inf if bone == 0 else 0.05 if bone == HAND else margin
        inside = (distance < radius[bone]) & (along > low) & (along < 1 - margin)
        # A finger's bone must not take hold of the next finger's flesh.
        inside &= _PART_OF_BONE[weights.argmax(1)] == _PART_OF_BONE[bone]
        fixed[inside & (fixed < 0)] = bone
    for h, bone in enumerate(_HINGES):
        size = _JOINT_SHARE * min(radius[bone], radius[parents[bone]])
        near = np.linalg.norm(vertices - joints[bone], axis=1) < size
        fixed[near & (fixed < 0)] = 17 + h
    arm = (joints[HAND] - joints[0]) / np.linalg.norm(joints[HAND] - joints[0])
    height = vertices @ arm
    fixed[height < height.min() + _END_CAP] = 0
    return fixed


@lru_cache(maxsize=2)
def _embedded(simulator: HandSimulator) -> EmbeddedSkin:
    return EmbeddedSkin(simulator.surface_vertices, simulator.tet_vertices, simulator.tets)


@lru_cache(maxsize=2)
def _tet_weights(simulator: HandSimulator) -> np.ndarray:
    return _embedded(simulator).weights(simulator.weights)
