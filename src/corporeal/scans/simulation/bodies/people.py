"""People: identity, a relief of their own, how soft their flesh is, skin tone; and their skin at rest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from corporeal.scans.simulation.bodies.files import BodySimulator
from corporeal.scans.simulation.identities import slow_normals, slow_waves

# Beyond two standard deviations the source's people are caricatures.
_LARGEST = 2.0
_RELIEF = (1.5e-3, 3.0e-3)
_WAVELENGTHS = (0.08, 0.2)
# What hands, feet and head have of the relief: they are small, and slow waves would bend them.
_ON_SMALL_PARTS = 0.15
_SMALL_PARTS = ("wrist", "metacarpal", "finger", "foot", "toe", "head", "eye")
_SOFTNESS = (0.6, 1.4)
_TONES = 6


@dataclass(frozen=True, eq=False)
class BodySubject:
    """One person.

    Attributes:
        name: "s01" and so on.
        identity: (S,) coefficients.
        relief: standard deviation in metres of slow bumps that no identity direction holds.
        softness: how far flesh swings, 1 for the mean person.
        seed: of the relief's waves and the skin's blotches.
        tone: number of the skin tone, 0 (light) to 5 (dark).
    """

    name: str
    identity: Float[np.ndarray, " S"]
    relief: float
    softness: float
    seed: int
    tone: int


def body_subject(simulator: BodySimulator, number: int, seed: int) -> BodySubject:
    """Person of a number, 0 being the first; the same number and seed give the same person."""
    generator = np.random.default_rng([seed, 11, number])
    count = simulator.identity_directions.shape[2]
    return BodySubject(
        name=f"s{number + 1:02d}",
        identity=np.clip(generator.normal(size=count), -_LARGEST, _LARGEST),
        relief=float(generator.uniform(*_RELIEF)),
        softness=float(generator.uniform(*_SOFTNESS)),
        seed=int(generator.integers(2**31)),
        tone=int(generator.integers(_TONES)),
    )


def body_at_rest(
    simulator: BodySimulator, subject: BodySubject
) -> tuple[Float[np.ndarray, "V 3"], Float[np.ndarray, "B 3"]]:
    """Skin and heads of the bones in the rig's rest stance, metres."""
    surface = simulator.vertices + simulator.identity_directions @ subject.identity
    heads = simulator.heads + simulator.identity_heads @ subject.identity
    waves = slow_waves(simulator.vertices, np.random.default_rng(subject.seed), _WAVELENGTHS)
    height = subject.relief * waves * (1 - (1 - _ON_SMALL_PARTS) * share_of(simulator, _SMALL_PARTS))
    return surface + height[:, None] * slow_normals(surface, simulator.faces), heads


def share_of(simulator: BodySimulator, bones: tuple[str, ...]) -> Float[np.ndarray, " V"]:
    """Skinning weight that vertices have on the bones whose names begin with one of these."""
    chosen = [number for number, bone in enumerate(simulator.bones) if bone.startswith(bones)]
    return np.asarray(simulator.weights[:, chosen].sum(1)).ravel()
