"""The body simulator's base, as it lies in the package."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float, Int

_BASE = Path(__file__).parents[1] / "body_simulator.npz"
_ANGLE_UNIT, _LENGTH_UNIT = 2e-4, 1e-4


@dataclass(frozen=True, eq=False)
class RecordedClip:
    """Recorded motion of a body, 60 frames per second.

    Attributes:
        name: what is seen in it.
        pose: (T, 22, 3) axis-angle of SMPL's joints against their parents, the root first, radians.
        translation: (T, 3) of the root's rest joint, metres, y up; along the ground about its middle.
    """

    name: str
    pose: Float[np.ndarray, "T 22 3"]
    translation: Float[np.ndarray, "T 3"]


@dataclass(frozen=True, eq=False)
class BodySimulator:
    """The mean adult in the MakeHuman mesh: skin, rig, identities, masks, motion.

    V vertices, B bones, S identity directions, P vertices of the open body's template. Metres, y up, z
    forward, in the relaxed stance of the rig.

    Attributes:
        vertices: (V, 3) skin with both eyeballs.
        faces: (F, 3), closed.
        heads: (B, 3) of the bones.
        bones: names.
        parents: (B,) of the bones, -1 for the first.
        turns: (B, 3, 3) of every bone from its rest to the open body's T-pose.
        weights: (V, B) the rig's own skinning weights.
        identity_directions: (V, 3, S) for coefficients of unit variance; ``identity_heads`` (B, 3, S).
        soft_masks: (V, 5) flesh that follows late: belly, breasts, buttocks.
        muscle_masks: (V, 4) muscles that swell: biceps, calves; left before right.
        template_faces: (P,) on which face of the skin the template's vertices lie.
        template_barycentric: (P, 3) and where on it.
        template_placed: (P,) which of them have a place; eyes have none.
        clips: recorded motion of bodies.
        finger_runs: recorded motion of fingers: each (n, 15, 3) axis-angle of a right hand, 30 per second.
    """

    vertices: Float[np.ndarray, "V 3"]
    faces: Int[np.ndarray, "F 3"]
    heads: Float[np.ndarray, "B 3"]
    bones: tuple[str, ...]
    parents: Int[np.ndarray, " B"]
    turns: Float[np.ndarray, "B 3 3"]
    weights: sp.csr_matrix
    identity_directions: Float[np.ndarray, "V 3 S"]
    identity_heads: Float[np.ndarray, "B 3 S"]
    soft_masks: Float[np.ndarray, "V 5"]
    muscle_masks: Float[np.ndarray, "V 4"]
    template_faces: Int[np.ndarray, " P"]
    template_barycentric: Float[np.ndarray, "P 3"]
    template_placed: Bool[np.ndarray, " P"]
    clips: tuple[RecordedClip, ...]
    finger_runs: tuple[Float[np.ndarray, "_ 15 3"], ...]

    def on_template(self, surface: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "P 3"]:
        """Where the template's vertices lie when the skin's lie at ``surface``."""
        return np.einsum("pc,pca->pa", self.template_barycentric, surface[self.faces[self.template_faces]])


@lru_cache(maxsize=1)
def load_body_simulator() -> BodySimulator:
    """The base of the package; read once."""
    with np.load(_BASE, allow_pickle=False) as stored:
        arrays = {name: stored[name] for name in stored.files}
    wide = {name: value.astype(np.float64) for name, value in arrays.items() if value.dtype.kind == "f"}
    barycentric = arrays["template_barycentric"].astype(np.float64)
    return BodySimulator(
        vertices=wide["vertices"],
        faces=arrays["faces"].astype(np.int64),
        heads=wide["heads"],
        bones=tuple(arrays["bones"].tolist()),
        parents=arrays["bone_parents"].astype(np.int64),
        turns=wide["bone_turns"],
        weights=_weights(arrays),
        identity_directions=wide["identity_directions"],
        identity_heads=wide["identity_heads"],
        soft_masks=wide["soft_masks"],
        muscle_masks=wide["muscle_masks"],
        template_faces=arrays["template_faces"].astype(np.int64),
        template_barycentric=barycentric / barycentric.sum(1, keepdims=True),
        template_placed=arrays["template_placed"],
        clips=_clips(arrays),
        finger_runs=_finger_runs(arrays),
    )


def _weights(arrays: dict[str, np.ndarray]) -> sp.csr_matrix:
    values, shape = (
        arrays["weight_values"].astype(np.float64),
        (len(arrays["vertices"]), len(arrays["bones"])),
    )
    places = (arrays["weight_rows"].astype(np.int64), arrays["weight_bones"].astype(np.int64))
    weights = sp.csr_matrix((values, places), shape=shape)
    return sp.csr_matrix(sp.diags(1 / np.asarray(weights.sum(1)).ravel()) @ weights)


def _clips(arrays: dict[str, np.ndarray]) -> tuple[RecordedClip, ...]:
    ends = np.cumsum(arrays["clip_lengths"])[:-1]
    poses = np.split(_ANGLE_UNIT * arrays["clip_pose"], ends)
    ways = np.split(_LENGTH_UNIT * arrays["clip_translation"], ends)
    names = arrays["clip_names"].tolist()
    return tuple(RecordedClip(*clip) for clip in zip(names, poses, ways, strict=True))


def _finger_runs(arrays: dict[str, np.ndarray]) -> tuple[np.ndarray, ...]:
    return tuple(np.split(_ANGLE_UNIT * arrays["finger_pose"], np.cumsum(arrays["finger_lengths"])[:-1]))
