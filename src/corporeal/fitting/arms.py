"""The arms of a body, and what of them a scan does not show."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool

from corporeal.fitting.arm_search import ArmSearch
from corporeal.fitting.frame_data import forearm_of, joints_above
from corporeal.model.surface_model import SurfaceModel
from corporeal.terms.hinges import Hinges

# A part of which no more than this share is confirmed by scan may be missing; of a fist a quarter is.
HARDLY_SEEN = 0.15
# Frames after its return in which an arm still finds its place: fingers sought before that were those of a
# hand turned about itself, and held it there.
SETTLING = 10
# A forearm of which more is seen is there, though its hand is not, and moves as the scan says: held like the
# hand, it made the upper arm turn for it. With 0.3 an arm that comes back elsewhere may count as seen where
# it crosses the place in which it was held, and is not looked for.
_FOREARM_SEEN = 0.5


@dataclass(frozen=True, eq=False)
class ArmPart:
    """What of an arm may be missing.

    Attributes:
        vertices: (V,) that belong to it.
        joints: that move them.
    """

    vertices: Bool[np.ndarray, " V"]
    joints: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Arm:
    """The arm of a hand.

    Attributes:
        hand_name: of the hand's block.
        fingers: joints of that.
        hand: with the wrist.
        whole: with the forearm too; of a hand alone the same.
        search: for an arm that has come back elsewhere; None where the elbow is no hinge.
    """

    hand_name: str
    fingers: tuple[int, ...]
    hand: ArmPart
    whole: ArmPart
    search: ArmSearch | None

    @classmethod
    def of_hand(
        cls, model: SurfaceModel, hinges: list[Hinges], name: str, faces: Bool[np.ndarray, " F"]
    ) -> Arm:
        """The arm of a hand's block with these faces."""
        block = model.block(name)
        above = joints_above(model, block)[:2]

        def part(joints: tuple[int, ...]) -> ArmPart:
            vertices = model.skinning_weights[:, list(joints)].sum(axis=1) > 0.5
            vertices[np.unique(model.faces[faces])] = True
            return ArmPart(vertices, joints + block.joints)

        search = ArmSearch.below(model, above[1], hinges[0]) if hinges and len(above) == 2 else None
        return cls(name, block.joints, part(above[:1]), part(above), search)

    def missing(self, shares: Mapping[str, float]) -> ArmPart | None:
        """What of it is not seen, by the shares that a scan confirms; None where its hand is."""
        if shares[f"{self.hand_name}_seen"] > HARDLY_SEEN:
            return None
        seen = shares.get(f"{forearm_of(self.hand_name)}_seen", 0.0)
        return self.hand if seen > _FOREARM_SEEN else self.whole
