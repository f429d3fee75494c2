"""A subject's joints, placed by the frames that its template is learned from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from corporeal.fitting.frame_data import FrameData, confirmed
from corporeal.fitting.frame_fit import FrameFitter
from corporeal.fitting.joint_places import JointPlaceOptions, PosedScan, joint_shifts
from corporeal.terms.model_fields import ModelParameters

_BODY = "body"
# Evenly from all frames: neighbours show the same pose.
_FRAMES = 17
_POINTS, _FEWEST = 4_000, 1_000
# Less than a second of walking or climbing tells strangers' knees, 32 mm off, to 5 mm; with a strength of 1
# they go two thirds of the way, with 0.2 collar bones and spine wander.
_OPTIONS = JointPlaceOptions(strength=0.4, reach=0.03, robust_distance=8e-3, steps=6)


@dataclass(frozen=True, eq=False)
class FittedFrame:
    """A frame and the parameters that fit it: place, pose and shape."""

    data: FrameData
    parameters: ModelParameters


def subject_joint_shifts(
    fitter: FrameFitter, frames: Sequence[FittedFrame]
) -> Float[np.ndarray, "K 3"] | None:
    """How far the joints of one person's body lie from where the model has them, metres; None if unknown.

    Fingers, jaw and eyes stay: scans of bodies show webs between fingers, and faces that hardly move.

    Args:
        fitter: of a model with shapes; only the joints of its block "body" are placed.
        frames: of one person.
    """
    model = fitter.model
    body = {joint for block in model.pose_blocks if block.name == _BODY for joint in block.joints}
    if not body or not frames:
        return None
    chosen = np.unique(np.linspace(0, len(frames) - 1, _FRAMES).astype(int))
    posed = [_posed(fitter, frames[index]) for index in chosen]
    usable = [scan for scan in posed if len(scan.points) >= _FEWEST]
    if not usable:
        return None
    fixed = tuple(name for joint, name in enumerate(model.joint_names) if joint not in body)
    return joint_shifts(model, usable, replace(_OPTIONS, fixed=fixed))[0]


def _posed(fitter: FrameFitter, frame: FittedFrame) -> PosedScan:
    """The points of a frame that lie on the body off its hands."""
    parameters, points = frame.parameters, frame.data.points
    vertices = fitter.fields.evaluated(parameters.vector()).vertices
    closest = fitter.surface.closest(vertices, points.positions, None)
    kept = confirmed(points, closest, vertices, fitter.surface, _OPTIONS.reach)
    kept &= ~fitter.on_hands[closest.faces]
    return PosedScan(
        frame.data.name, "subject", points.positions[kept][:_POINTS], parameters.pose, parameters.shape,
        parameters.translation,
    )  # fmt: skip
