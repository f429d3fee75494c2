"""The open hand as a soft body: the start hand's own mesh, joints and weights around bones inside flesh.

The flesh, its bones as rods and its contact are those of ``docs/simulation.md``; mesh, joints, skinning and
zero pose are the start hand's, and nothing of the simulator's people is read. At the zero pose nothing is
strained.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from hand_simulator.skeleton_axes import axes_at_rest

from corporeal.geometry.rotations_numeric import axis_angle_from_matrix
from corporeal.model.surface_model import SurfaceModel
from corporeal.scans.simulation.files import HandSimulator
from corporeal.scans.simulation.hand_flesh import SoftHand

TETRAHEDRA = Path(__file__).with_name("tetrahedra.npz")
_TIPS = ("index_tip", "middle_tip", "little_tip", "ring_tip", "thumb_tip")
# Where the forearm begins that the simulator's tree begins with; it stays still.
_FOREARM = np.array([0.1, 0, 0])
_PARENTS = np.array([-1, 0, *(1 if k == 0 else 3 * f + k + 1 for f in range(5) for k in range(3))])


@dataclass(frozen=True, eq=False)
class SettledHand:
    """A settled hand: its skin (V, 3) in metres, and the pose (16, 3) that was reached, axis-angle."""

    surface: np.ndarray
    pose: np.ndarray
    volume_ratio: float


class SoftOpenHand:
    """A person whose skin has the open hand's topology."""

    def __init__(self, model: SurfaceModel, surface: np.ndarray) -> None:
        """Carry the tetrahedra over to a person and find the bones in them.

        Raises:
            ValueError: the person is so unlike the template that an element is inverted at rest.
        """
        self._base = _base(model)
        self._parents = np.asarray(model.parents)
        self._hand = SoftHand(self._base, surface, _joints(model, surface))

    def posed(self, angles: np.ndarray) -> SettledHand:
        """Settle the flesh at flexion, spread and twist of the 15 finger bones (15, 3), degrees."""
        settled = self._hand.posed(np.vstack([np.zeros((2, 3)), angles]))
        turned = settled.motions[1:, :3, :3]
        local = np.swapaxes(turned[self._parents[1:]], 1, 2) @ turned[1:]
        pose = np.vstack([np.zeros(3), axis_angle_from_matrix(local)])
        return SettledHand(settled.surface, pose, settled.flesh.volume_ratio)


def _joints(model: SurfaceModel, surface: np.ndarray) -> np.ndarray:
    """(22, 3) heads of the bones, then the tips of the fingers, metres."""
    joints = model.joint_regressor @ surface
    marks = model.landmarks["hand_21_mediapipe"]
    tips = (marks.weights @ np.vstack([surface, joints]))[[marks.names.index(name) for name in _TIPS]]
    return np.vstack([joints[0] + _FOREARM, joints, tips])


@lru_cache(maxsize=2)
def _base(model: SurfaceModel) -> HandSimulator:
    """The start hand as the simulator knows a hand: a forearm before the wrist, and no other people."""
    template, V = model.template, model.vertex_count
    arm = template[:, :1] > 0
    joints, wrist = _joints(model, template), model.skinning_weights[:, :1]
    axes, rest_angles = axes_at_rest(joints[1:17], joints[1:17], joints[17:])
    with np.load(TETRAHEDRA) as arrays:
        vertices, tets = arrays["tet_vertices"].astype(np.float64), arrays["tets"].astype(np.int64)
    return HandSimulator(
        surface_vertices=template, surface_faces=model.faces, joints=joints,
        weights=np.hstack([arm * wrist, ~arm * wrist, model.skinning_weights[:, 1:]]), parents=_PARENTS,
        identity_directions=np.zeros((V, 3, 0)), identity_joints=np.zeros((22, 3, 0)),
        axes=axes, rest_angles=rest_angles, tet_vertices=vertices, tets=tets,
        template_faces=np.empty(0, dtype=np.int64), template_barycentric=np.empty((0, 3)), template_sha256="",
    )  # fmt: skip
