"""People: identity coefficients, a relief of their own, skin tone; and their hands at rest."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int

from corporeal.geometry.normals import vertex_normals
from corporeal.geometry.topology import unique_edges
from corporeal.scans.simulation.files import HandSimulator

Side = Literal["left", "right"]
# Beyond two standard deviations the source's hands are caricatures.
_LARGEST = 2.0
_RELIEF = (0.3e-3, 0.6e-3)
_WAVELENGTHS = (0.03, 0.06)
_WAVES = 24
_NORMAL_ROUNDS = 12
_ASYMMETRY = 0.1
_LEFT_RELIEF = 0.2e-3
_TONES = 6


@dataclass(frozen=True, eq=False)
class Subject:
    """One person.

    Attributes:
        name: "s01" and so on.
        identity: (S,) coefficients of the right hand.
        asymmetry: (S,) what the left hand adds to them.
        relief: standard deviation in metres of slow bumps that no identity direction holds.
        seed: of the relief's waves.
        tone: number of the skin tone, 0 (light) to 5 (dark).
    """

    name: str
    identity: Float[np.ndarray, " S"]
    asymmetry: Float[np.ndarray, " S"]
    relief: float
    seed: int
    tone: int


def sample_subjects(simulator: HandSimulator, count: int, seed: int) -> tuple[Subject, ...]:
    """People of a session; the first of a larger session are those of a smaller one with the same seed."""
    return tuple(_subject(simulator, number, seed) for number in range(count))


def _subject(simulator: HandSimulator, number: int, seed: int) -> Subject:
    generator = np.random.default_rng([seed, 1, number])
    size = simulator.identity_count
    return Subject(
        name=f"s{number + 1:02d}",
        identity=np.clip(generator.normal(size=size), -_LARGEST, _LARGEST),
        asymmetry=_ASYMMETRY * generator.normal(size=size),
        relief=float(generator.uniform(*_RELIEF)),
        seed=int(generator.integers(2**31)),
        tone=int(generator.integers(_TONES)),
    )


def hand_at_rest(
    simulator: HandSimulator, subject: Subject, side: Side
) -> tuple[Float[np.ndarray, "N 3"], Float[np.ndarray, "22 3"]]:
    """Skin and joints at rest, metres; a left hand is given as the right hand that is its mirror image."""
    left = side == "left"
    coefficients = subject.identity + (subject.asymmetry if left else 0)
    surface = simulator.surface_vertices + simulator.identity_directions @ coefficients
    joints = simulator.joints + simulator.identity_joints @ coefficients
    # Waves run over the mean hand, so that both hands of a person have the same bumps in the same places.
    height = subject.relief * slow_waves(simulator.surface_vertices, np.random.default_rng(subject.seed))
    if left:
        height += _LEFT_RELIEF * slow_waves(
            simulator.surface_vertices, np.random.default_rng([subject.seed, 1])
        )
    return surface + height[:, None] * slow_normals(surface, simulator.surface_faces), joints


def slow_normals(
    surface: Float[np.ndarray, "N 3"], faces: Int[np.ndarray, "F 3"]
) -> Float[np.ndarray, "N 3"]:
    """Normals averaged over some millimetres.

    Along the vertices own, half a millimetre of relief folded the skin over itself in the nails groove.
    """
    normals = vertex_normals(surface, faces)
    edges = unique_edges(faces)
    ends = np.concatenate([edges, edges[:, ::-1]])
    shape = (len(surface), len(surface))
    around = sp.csr_matrix((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=shape)
    for _ in range(_NORMAL_ROUNDS):
        normals = normals + around @ normals
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return normals


def slow_waves(
    points: Float[np.ndarray, "N 3"],
    generator: np.random.Generator,
    wavelengths: tuple[float, float] = _WAVELENGTHS,
) -> Float[np.ndarray, " N"]:
    """Smooth random numbers of about unit variance: plane waves of random direction, length and phase.

    Args:
        points: metres.
        generator: the same state gives the same waves.
        wavelengths: the shortest and the longest, metres.
    """
    directions = generator.normal(size=(_WAVES, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    lengths = generator.uniform(*wavelengths, size=_WAVES)
    phases = generator.uniform(0, 2 * np.pi, _WAVES)
    waves = np.sin(points @ (2 * np.pi * directions / lengths[:, None]).T + phases)
    return np.sqrt(2 / _WAVES) * waves.sum(axis=1)
