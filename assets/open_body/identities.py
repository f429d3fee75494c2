"""Adults from the anny wheel, each brought to a stature and a body mass drawn from published anthropometry.

Phenotypes of the generator are bounded dials, not distributions: drawn uniformly they give caricatures. Here
stature and body mass index are drawn per sex as ANSUR II (2012) has them, and the generator's dials for
height and weight are turned until the mesh has them. All other dials vary around their middle.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

RIG = TOPOLOGY = "soma"
# ANSUR II (Gordon et al. 2014, NATICK/TR-15/007): mean and standard deviation of stature in metres; body mass
# index from its mean weight and the coefficient of variation that weight has beyond stature's.
STATURE = {"female": (1.628, 0.064), "male": (1.756, 0.069)}
MASS_INDEX = {"female": (25.5, 0.142), "male": (27.7, 0.146)}
# kg / m3, lungs half full.
DENSITY = 985.0
_DIALS = {"age": 0.07, "muscle": 0.12, "proportions": 0.15, "cupsize": 0.15, "firmness": 0.12}
_CENTRES = {"age": 0.72, "muscle": 0.6, "proportions": 0.5, "cupsize": 0.5, "firmness": 0.5}
# Local changes and their standard deviation; a name without side is given to both sides alike.
_CHANGES = {
    "hand-scale-incr": 0.10, "hand-fingers-length-incr": 0.20, "hand-fingers-diameter-incr": 0.5,
    "hand-fingers-distance-incr": 0.3, "measure-wrist-circ-incr": 0.3,
    "measure-upperarm-length-incr": 0.12, "measure-lowerarm-length-incr": 0.12,
    "measure-upperarm-circ-incr": 0.15, "lowerarm-fat-incr": 0.25, "upperarm-muscle-incr": 0.25,
    "measure-upperleg-height-incr": 0.12, "measure-lowerleg-height-incr": 0.12,
    "measure-thigh-circ-incr": 0.15, "measure-calf-circ-incr": 0.2, "foot-scale-incr": 0.1,
    "measure-shoulder-dist-incr": 0.15, "measure-hips-circ-incr": 0.2, "measure-waist-circ-incr": 0.2,
    "measure-bust-circ-incr": 0.15, "torso-scale-depth-incr": 0.2, "torso-vshape-incr": 0.25,
    "buttocks-volume-incr": 0.25, "stomach-tone-incr": 0.3, "measure-napetowaist-dist-incr": 0.12,
    "measure-neck-circ-incr": 0.25, "measure-neck-height-incr": 0.2, "head-scale-vert-incr": 0.2,
    "head-scale-depth-incr": 0.2, "head-scale-horiz-incr": 0.2, "head-fat-incr": 0.25,
    "forehead-scale-vert-incr": 0.25, "nose-scale-vert-incr": 0.3, "nose-scale-horiz-incr": 0.3,
    "nose-scale-depth-incr": 0.3, "nose-hump-incr": 0.3, "nose-point-up": 0.3,
    "mouth-scale-horiz-incr": 0.3, "mouth-trans-up": 0.25, "mouth-upperlip-volume-incr": 0.3,
    "mouth-lowerlip-volume-incr": 0.3, "chin-width-incr": 0.3, "chin-height-incr": 0.25,
    "chin-prominent-incr": 0.25, "eye-scale-incr": 0.2, "eye-trans-out": 0.2, "eyebrows-trans-up": 0.3,
    "cheek-bones-incr": 0.3, "cheek-volume-incr": 0.3, "ear-scale-incr": 0.3, "ear-wing-incr": 0.3,
}  # fmt: skip
# The generator's heaviest adults have a body mass index of 25: beyond it these go with the dial.
_STOUT = (
    "measure-waist-circ-incr", "measure-hips-circ-incr", "measure-bust-circ-incr",
    "measure-underbust-circ-incr", "measure-thigh-circ-incr", "measure-calf-circ-incr",
    "measure-upperarm-circ-incr", "measure-neck-circ-incr", "upperleg-fat-incr", "lowerleg-fat-incr",
    "upperarm-fat-incr", "lowerarm-fat-incr", "buttocks-volume-incr", "torso-scale-depth-incr",
    "head-fat-incr", "neck-double-incr",
)  # fmt: skip
_STOUT_FROM, _STOUT_RATE, _HEAVIEST = 0.7, 0.55, 2.2
# The jaw is a joint of the model: units that open or shift it would say the same twice.
JOINTED_UNITS = ("jawForward", "jawLeft", "jawOpen", "jawRight")
_ROUNDS = 7
_BATCH = 25


@dataclass(frozen=True, eq=False)
class Bodies:
    """N people in the rest pose of the rig: vertices (N, V, 3) and bone heads (N, B, 3), metres, our frame.

    The first half is female. ``units`` (U, V, 3) are displacements of the face units on the mean person.
    """

    vertices: np.ndarray
    heads: np.ndarray
    male: np.ndarray
    faces: np.ndarray
    weights: np.ndarray
    bones: tuple[str, ...]
    units: np.ndarray
    unit_names: tuple[str, ...]


def sample_bodies(count: int, seed: int, cache: Path) -> Bodies:
    """Half of them women; the same seed gives the same people."""
    import anny
    from anny.paths import set_anny_cache_path

    set_anny_cache_path(str(cache))
    source = anny.Anny(
        rig=RIG, topology=TOPOLOGY, local_changes="all", facial_actions="all", phenotypes="all"
    )
    generator = np.random.default_rng(seed)
    male = np.arange(count) >= count // 2
    faces = source.get_triangular_faces().numpy().astype(np.int64)
    phenotypes, changes = _drawn(generator, male, source.local_change_labels)
    vertices, heads = _of_stature_and_mass(source, phenotypes, changes, faces, generator, male)
    unit_names = tuple(name for name in source.facial_action_labels if name not in JOINTED_UNITS)
    weights = np.zeros((vertices.shape[1], len(source.bone_labels)))
    indices = source.vertex_bone_indices.numpy()
    np.add.at(weights, (np.arange(len(weights))[:, None], indices), source.vertex_bone_weights.numpy())
    return Bodies(
        vertices, heads, male, faces, weights, tuple(source.bone_labels), _units(source, unit_names),
        unit_names
    )  # fmt: skip


def volumes(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Enclosed volume (N,) in cubic metres."""
    a, b, c = (vertices[:, faces[:, k]] for k in range(3))
    return np.einsum("nfa,nfa->n", a, np.cross(b, c)) / 6


def _drawn(generator: np.random.Generator, male: np.ndarray, labels: list[str]) -> tuple[dict, dict]:
    count = len(male)
    nearly = generator.uniform(0, 0.1, count)
    phenotypes = {"gender": np.where(male, nearly, 1 - nearly)}  # the generator's 0 is male
    for name, spread in _DIALS.items():
        phenotypes[name] = np.clip(_CENTRES[name] + spread * generator.normal(size=count), 0.1, 0.9)
    origin = generator.dirichlet([1, 1, 1], size=count).T
    phenotypes |= dict(zip(("african", "asian", "caucasian"), origin, strict=True))
    changes = {}
    for name, spread in _CHANGES.items():
        values = np.clip(spread * generator.normal(size=count), -2 * spread, 2 * spread)
        changes |= dict.fromkeys(_labels_of(name, labels), values)
    return phenotypes, changes


def _labels_of(name: str, labels: list[str]) -> list[str]:
    found = [f"{side}-{name}" for side in "lr" if f"{side}-{name}" in labels] or [name]
    if found[0] not in labels:
        raise ValueError(f"the generator has no local change {name!r}")
    return found


def _weighing(source: object, phenotypes: dict, changes: dict, dials: np.ndarray) -> tuple[dict, dict]:
    """Phenotypes and local changes at dials for height (0 to 1) and weight (beyond 1: stouter by changes)."""
    stout = _STOUT_RATE * np.maximum(dials[:, 1] - _STOUT_FROM, 0)
    added = {label: stout for name in _STOUT for label in _labels_of(name, source.local_change_labels)}
    changed = {k: np.clip(changes.get(k, 0) + added.get(k, 0), -1, 1) for k in changes | added}
    return phenotypes | {"height": dials[:, 0], "weight": np.minimum(dials[:, 1], 1)}, changed


def _of_stature_and_mass(
    source: object, phenotypes: dict, changes: dict, faces: np.ndarray, generator: np.random.Generator,
    male: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Turn the dials for height and weight (Broyden's method) to the stature and mass that were drawn."""
    sexes = np.where(male, "male", "female")
    wanted = np.array([STATURE[s][0] for s in sexes]) + np.array(
        [STATURE[s][1] for s in sexes]
    ) * generator.normal(size=len(male))
    spread = np.array([MASS_INDEX[s][1] for s in sexes])
    index = np.array([MASS_INDEX[s][0] for s in sexes]) * np.exp(
        spread * generator.normal(size=len(male)) - spread**2 / 2
    )
    target = np.stack([wanted, np.log(index * wanted**2)], axis=1)
    dials = np.full((len(male), 2), 0.5)
    # Metres and log kilograms per unit of the dials for height and weight; then as each person answers.
    slopes = np.tile([[0.6, 0.0], [1.2, 0.7]], (len(male), 1, 1))
    before = None
    for _ in range(_ROUNDS):
        vertices, heads = _posed(source, *_weighing(source, phenotypes, changes, dials))
        mass = DENSITY * volumes(vertices, faces)
        got = np.stack([np.ptp(vertices[:, :, 1], axis=1), np.log(mass)], axis=1)
        if before is not None:
            slopes = _answered(slopes, dials - before[0], got - before[1])
        before = dials, got
        steps = np.linalg.solve(slopes, (target - got)[..., None])[..., 0]
        dials = np.clip(dials + np.clip(steps, -0.3, 0.3), 0.02, [0.98, _HEAVIEST])
    return vertices, heads


def _answered(slopes: np.ndarray, moved: np.ndarray, answered: np.ndarray) -> np.ndarray:
    """Broyden's update, for people whose dials moved."""
    length = np.sum(moved**2, axis=1)
    wrong = answered - np.einsum("nab,nb->na", slopes, moved)
    update = wrong[:, :, None] * moved[:, None] / np.maximum(length, 1e-12)[:, None, None]
    return slopes + np.where((length > 1e-4)[:, None, None], update, 0)


def _posed(source: object, phenotypes: dict, changes: dict) -> tuple[np.ndarray, np.ndarray]:
    import torch

    vertices, heads = [], []
    count = len(phenotypes["gender"])
    for first in range(0, count, _BATCH):
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


def _units(source: object, names: tuple[str, ...]) -> np.ndarray:
    import torch

    with torch.no_grad():
        neutral = _our_frame(source()["rest_vertices"])[0]
        return np.array(
            [
                _our_frame(source(facial_actions={n: torch.ones(1)})["rest_vertices"])[0] - neutral
                for n in names
            ]
        )


def _our_frame(points: object) -> np.ndarray:
    """The source has z up and looks along -y."""
    p = points.numpy().astype(np.float64)
    return np.stack([p[..., 0], p[..., 2], -p[..., 1]], axis=-1)
