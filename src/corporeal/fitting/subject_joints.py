"""A subject's joints, placed by the frames that its template is learned from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from corporeal.fitting.frame_data import FrameData, HandFaces, confirmed
from corporeal.fitting.joint_places import JointPlaceOptions, PosedScan, joint_shifts
from corporeal.model.jacobian import evaluate
from corporeal.model.surface_model import SurfaceModel
from corporeal.terms.model_fields import ModelParameters
from corporeal.terms.scan_to_surface import MovingSurface

_BODY = "body"
# Evenly from all frames: neighbours show the same pose.
_FRAMES = 17
_POINTS, _FEWEST = 4_000, 1_000
# Less than a second of walking or climbing tells strangers' knees, 31 mm off, to 4 mm; with a strength of 1
# they go two thirds of the way, with 0.2 collar bones and spine wander.
_OPTIONS = JointPlaceOptions(strength=0.4, reach=0.03, robust_distance=8e-3, steps=6)


@dataclass(frozen=True, eq=False)
class FittedFrame:
    """A frame and the parameters that fit it: place, pose and shape."""

    data: FrameData
    parameters: ModelParameters


def subject_joint_shifts(
    model: SurfaceModel, frames: Sequence[FittedFrame]
) -> Float[np.ndarray, "K 3"] | None:
    """How far the joints of one person's body lie from where the model has them, metres; None if unknown.

    Fingers, jaw and eyes stay: scans of bodies show webs between fingers, and faces that hardly move.

    Args:
        model: with shapes; only the joints of its block "body" are placed.
        frames: of one person.
    """
    body = {joint for block in model.pose_blocks if block.name == _BODY for joint in block.joints}
    if not body or not frames:
        return None
    surface = MovingSurface(model.template, model.faces)
    hands = HandFaces.of_model(model).any_hand(len(model.faces))
    chosen = np.unique(np.linspace(0, len(frames) - 1, _FRAMES).astype(int))
    posed = [_posed(model, surface, hands, frames[index]) for index in chosen]
    usable = [scan for scan in posed if len(scan.points) >= _FEWEST]
    if not usable:
        return None
    fixed = tuple(name for joint, name in enumerate(model.joint_names) if joint not in body)
    return joint_shifts(model, usable, replace(_OPTIONS, fixed=fixed))[0]


def _posed(
    model: SurfaceModel, surface: MovingSurface, hands: Bool[np.ndarray, " F"], frame: FittedFrame
) -> PosedScan:
    """The points of a frame that lie on the body off its hands."""
    parameters, points = frame.parameters, frame.data.points
    vertices = evaluate(model, parameters.shape, parameters.pose, parameters.translation).vertices
    closest = surface.closest(vertices, points.positions, None)
    kept = confirmed(points, closest, vertices, surface, _OPTIONS.reach) & ~hands[closest.faces]
    return PosedScan(
        frame.data.name, "subject", points.positions[kept][:_POINTS], parameters.pose, parameters.shape,
        parameters.translation,
    )  # fmt: skip
