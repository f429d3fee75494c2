"""A simulated person in motion: skin and bones of every frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from corporeal.geometry.normals import vertex_normals
from corporeal.scans.simulation.bodies.bones import bone_places, bone_rotations
from corporeal.scans.simulation.bodies.files import BodySimulator
from corporeal.scans.simulation.bodies.motion import FPS, BodyMotion
from corporeal.scans.simulation.bodies.people import BodySubject, body_at_rest, share_of
from corporeal.scans.simulation.bodies.skinning import dual_quaternion_skinned
from corporeal.scans.simulation.bodies.softness import CARRIERS, muscle_heights, soft_offsets

# Bones in SMPL-X's order of joints; the jaw, which the rig does not have, is a place in the head.
_FINGERS = (2, 3, 5, 4, 1)
_BODY = (
    "root", "upperleg01.L", "upperleg01.R", "spine04", "lowerleg01.L", "lowerleg01.R", "spine03", "foot.L",
    "foot.R", "spine01", "toe2-1.L", "toe2-1.R", "neck01", "clavicle.L", "clavicle.R", "head", "upperarm01.L",
    "upperarm01.R", "lowerarm01.L", "lowerarm01.R", "wrist.L", "wrist.R", "", "eye.L", "eye.R",
)  # fmt: skip
_JOINT_BONES = _BODY + tuple(f"finger{f}-{k}.{side}" for side in "LR" for f in _FINGERS for k in (1, 2, 3))
_JAW = 22
# The jaw's joint from the middle between the eyes, metres: down and back, before the ears.
_JAW_FROM_EYES = np.array([0.0, -0.045, -0.06])
# Share of a sequence's frames in which the soles may reach below the ground.
_BELOW = 0.1


@dataclass(frozen=True, eq=False)
class PosedBody:
    """One frame: skin (V, 3) and joints (55, 3) in the world, metres, y up."""

    vertices: Float[np.ndarray, "V 3"]
    joints: Float[np.ndarray, "55 3"]


class MovingPerson:
    """One person doing one motion."""

    def __init__(self, simulator: BodySimulator, subject: BodySubject, motion: BodyMotion) -> None:
        self.simulator, self.subject, self.motion = simulator, subject, motion
        self.rest, self.heads = body_at_rest(simulator, subject)
        self._normals = vertex_normals(self.rest, simulator.faces)
        self._rotations = np.array(
            [bone_rotations(p, simulator.bones) @ simulator.turns for p in motion.pose]
        )
        scale = self._leg(self.heads) / self._leg(simulator.heads)
        self._heads = np.array(
            [bone_places(self.heads, simulator.parents, turned) for turned in self._rotations]
        )
        self._heads += (scale * motion.translation - self.heads[0])[:, None]
        self._heads[..., 1] -= np.quantile(self._lowest(), _BELOW)
        carriers = [simulator.bones.index(bone) for bone in CARRIERS]
        self._soft = soft_offsets(self._heads[:, carriers], subject.softness, FPS)

    def posed(self, frame: int) -> PosedBody:
        """Skin and joints of a frame."""
        simulator, rotations, heads = self.simulator, self._rotations[frame], self._heads[frame]
        swollen = simulator.muscle_masks @ muscle_heights(self.motion.pose[frame])
        rest = self.rest + swollen[:, None] * self._normals
        translations = heads - np.einsum("bac,bc->ba", rotations, self.heads)
        skin = dual_quaternion_skinned(rest, simulator.weights, simulator.parents, rotations, translations)
        skin += simulator.soft_masks @ self._soft[frame]
        return PosedBody(skin, self._joints(rotations, heads))

    def _joints(self, rotations: np.ndarray, heads: np.ndarray) -> np.ndarray:
        number = {bone: k for k, bone in enumerate(self.simulator.bones)}
        joints = heads[[number.get(bone, 0) for bone in _JOINT_BONES]]
        eyes = (heads[number["eye.L"]] + heads[number["eye.R"]]) / 2
        joints[_JAW] = eyes + rotations[number["head"]] @ _JAW_FROM_EYES
        return joints

    def _lowest(self) -> np.ndarray:
        """Height of the lowest point of the soles in every frame, feet taken as rigid."""
        lowest = np.full(len(self._heads), np.inf)
        for side in "LR":
            foot = self.simulator.bones.index(f"foot.{side}")
            own = share_of(self.simulator, (f"foot.{side}",)) > 0.5
            offsets = self.rest[own] - self.heads[foot]
            heights = self._rotations[:, foot, 1] @ offsets.T + self._heads[:, foot, 1, None]
            lowest = np.minimum(lowest, heights.min(1))
        return lowest

    def _leg(self, heads: np.ndarray) -> float:
        hip, knee, foot = (
            heads[self.simulator.bones.index(f"{bone}.L")] for bone in ("upperleg01", "lowerleg01", "foot")
        )
        return float(np.linalg.norm(hip - knee) + np.linalg.norm(knee - foot))
