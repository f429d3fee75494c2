"""The simulator's base hand, as it lies in the package."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

_BASE = Path(__file__).parent / "hand_simulator.npz"
_RECORDED = Path(__file__).parent / "recorded_poses.npz"


@dataclass(frozen=True, eq=False)
class HandSimulator:
    """The mean adult's right hand with forearm: skin, bones, identities and tetrahedra.

    N skin vertices; 17 bones (forearm, hand, then index, middle, little, ring and thumb with three each); S
    identity directions; T vertices and M tetrahedra; P vertices of the open hand's template. Metres, in the
    frame of a right model hand: fingers along -x, back of the hand up (+y), thumb towards +z, wrist at the
    origin.

    Attributes:
        surface_vertices: (N, 3) skin at rest.
        surface_faces: (F, 3), open at the forearm only.
        joints: (22, 3) heads of the bones, then the five finger tips.
        weights: (N, 17) skinning weights: first guesses and comparison, the flesh finds its own way.
        parents: (17,) of the bones, -1 for the forearm.
        identity_directions: (N, 3, S) of the skin for coefficients of unit variance.
        identity_joints: (22, 3, S) of the joints.
        axes: (17, 3, 3) rows: flexion, spread and twist axis at rest, right-handed.
        rest_angles: (17, 3) degrees that the rest pose has against the flat hand.
        tet_vertices: (T, 3).
        tets: (M, 4) of positive volume.
        template_faces: (P,) where the template's vertices lie: faces of the skin after one Loop step.
        template_barycentric: (P, 3) and where on them.
        template_sha256: of the template's array that was embedded.
    """

    surface_vertices: Float[np.ndarray, "N 3"]
    surface_faces: Int[np.ndarray, "F 3"]
    joints: Float[np.ndarray, "22 3"]
    weights: Float[np.ndarray, "N 17"]
    parents: Int[np.ndarray, "17"]
    identity_directions: Float[np.ndarray, "N 3 S"]
    identity_joints: Float[np.ndarray, "22 3 S"]
    axes: Float[np.ndarray, "17 3 3"]
    rest_angles: Float[np.ndarray, "17 3"]
    tet_vertices: Float[np.ndarray, "T 3"]
    tets: Int[np.ndarray, "M 4"]
    template_faces: Int[np.ndarray, " P"]
    template_barycentric: Float[np.ndarray, "P 3"]
    template_sha256: str

    @property
    def identity_count(self) -> int:
        """Number of identity directions."""
        return self.identity_directions.shape[2]


@lru_cache(maxsize=1)
def load_simulator() -> HandSimulator:
    """The base hand of the package; read once."""
    with np.load(_BASE, allow_pickle=False) as stored:
        arrays = {name: stored[name] for name in stored.files}
    joints = np.vstack([arrays.pop("joints"), arrays.pop("tips")])
    digest = str(arrays.pop("template_sha256"))
    typed = {name: _wide(value) for name, value in arrays.items()}
    typed["weights"] /= typed["weights"].sum(1, keepdims=True)
    typed["template_barycentric"] /= typed["template_barycentric"].sum(1, keepdims=True)
    return HandSimulator(joints=joints, template_sha256=digest, **typed)


@lru_cache(maxsize=1)
def recorded_angles() -> Float[np.ndarray, "n 15 3"]:
    """Recorded poses: flexion, spread and twist of index, middle, little, ring and thumb in degrees."""
    with np.load(_RECORDED, allow_pickle=False) as stored:
        return stored["hundredths_of_degree"].astype(np.float64) / 100


def _wide(values: np.ndarray) -> np.ndarray:
    return values.astype(np.int64 if values.dtype.kind in "ui" else np.float64)
