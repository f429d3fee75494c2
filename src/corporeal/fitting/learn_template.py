"""Stage one of tracking: a subject's template from the first frames (Romero et al. 2017, section 4.3.1).

The frames are followed forth. By what the rigged model misses in them the subject's joints are placed, and
the frames followed back again, from the last, where shape and hands are known best, to the first.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from itertools import islice

import numpy as np
from jaxtyping import Float

from corporeal.fitting.frame_data import FrameData, frame_points
from corporeal.fitting.frame_fit import FrameFitter, FrameStart, scan_surface
from corporeal.fitting.joint_places import with_shifted_joints
from corporeal.fitting.options import HandPose, TrackingOptions
from corporeal.fitting.subject_joints import FittedFrame, subject_joint_shifts
from corporeal.fitting.subject_template import SubjectTemplate, personal_model
from corporeal.fitting.track import judged
from corporeal.fitting.unposing import unposed
from corporeal.model.surface_model import SurfaceModel
from corporeal.scans.scan import Scan
from corporeal.terms.model_fields import ModelParameters

# A frame is badly unposed where more than a twentieth of its vertices lies farther than this from the median
# of all frames: in place of the paper's look at each.
_UNPOSED_P95 = 8e-3
# So many frames tell the shape anew once joints are placed.
_FOR_SHAPE = 8


class TemplateError(ValueError):
    """No frame of a sequence could be used for a subject's template."""


def learn_subject_template(
    frames: Iterable[tuple[str, Scan | None]],
    model: SurfaceModel,
    start: ModelParameters,
    options: TrackingOptions | None = None,
    on_step: Callable[[str], None] | None = None,
) -> SubjectTemplate:
    """A personal template from the first ``options.template_frames`` frames.

    Args:
        frames: name and scan, None where a frame is missing; read one at a time.
        model: the body.
        start: a registration of the first frame that has a scan: place, pose, and what shape there is.
        options: of tracking.
        on_step: told each frame's name, as often as it is looked at.

    Raises:
        TemplateError: no frame could be used.
    """
    options = options or TrackingOptions()
    tell = on_step or (lambda name: None)
    plain = model.replace(expression_directions=np.zeros((model.vertex_count, 3, 0)))
    # Six components do not reach every fist, and what the pose cannot say the template would.
    hands: HandPose = "flat" if options.hands == "flat" else "full"
    options = replace(
        options, hands=hands, shape_count=min(options.shape_count, plain.shape_count),
        coarse_weight=options.template_coarse_weight,
    )  # fmt: skip
    fitter = FrameFitter(plain, options, shape_count=options.shape_count)
    rejected: dict[str, str] = {}
    usable = _usable(islice(frames, options.template_frames), options, rejected)
    followed = _followed(fitter, usable, _started(fitter, start), rejected, tell)
    shifts = subject_joint_shifts(fitter, followed) if options.place_joints else None
    if shifts is not None:
        fitter = FrameFitter(with_shifted_joints(plain, shifts), options, shape_count=options.shape_count)
        followed = _followed_back(fitter, followed, rejected, tell)
    template, kept = _averaged(fitter, followed, rejected)
    joints = None if shifts is None else fitter.model.joint_regressor @ template
    # Also where the first is badly unposed: it is where the second stage starts.
    first = followed[0].parameters
    return SubjectTemplate(
        personal_model(model, template, joints), first.shape, tuple(one.data.name for one in kept), rejected,
        first.pose, first.translation, shifts,
    )  # fmt: skip


def _usable(
    frames: Iterable[tuple[str, Scan | None]], options: TrackingOptions, rejected: dict[str, str]
) -> Iterable[FrameData]:
    for name, scan in frames:
        if scan is None or len(scan.points) < options.bounds.fewest_points:
            rejected[name] = "no scan, or too few points"
        else:
            yield FrameData(name, frame_points(scan, options), scan_surface(scan))


def _started(fitter: FrameFitter, start: ModelParameters) -> FrameStart:
    shape = np.zeros(fitter.fields.shape_count)
    given = start.shape[: len(shape)]
    shape[: len(given)] = given
    return FrameStart(ModelParameters(start.translation, start.pose, shape).vector(), first=True)


def _followed(
    fitter: FrameFitter, frames: Iterable[FrameData], begin: FrameStart, rejected: dict[str, str],
    tell: Callable[[str], None],
) -> list[FittedFrame]:  # fmt: skip
    """The frames fitted one after the other, each held to the mean shape of those before it."""
    followed: list[FittedFrame] = []
    shapes = begin.shapes
    mean = np.zeros(fitter.fields.shape_count) if begin.shape is None else begin.shape
    for frame in frames:
        tell(frame.name)
        parameters, reason = _fitted(fitter, frame, begin)
        if parameters is None:
            rejected[frame.name] = reason
            continue
        followed.append(FittedFrame(frame, parameters))
        shapes, mean = shapes + 1, (shapes * mean + parameters.shape) / (shapes + 1)
        begin = FrameStart(parameters.vector(), parameters.pose, shape=mean, shapes=shapes)
    return followed


def _followed_back(
    fitter: FrameFitter, forth: Sequence[FittedFrame], rejected: dict[str, str], tell: Callable[[str], None]
) -> list[FittedFrame]:
    """The frames once more, from the last to the first; they are given from the first to the last."""
    chosen = np.unique(np.linspace(0, len(forth) - 1, _FOR_SHAPE).astype(int))
    # Frames of all poses tell the shape first: which one comes first would decide it otherwise.
    shapes = []
    for one in (forth[index] for index in chosen):
        found, _ = _fitted(fitter, one.data, _again(one.parameters))
        shapes += [] if found is None else [found.shape]
    mean = np.mean(shapes, axis=0) if shapes else None
    begin = replace(_again(forth[-1].parameters), shape=mean, shapes=len(shapes))
    return _followed(fitter, [one.data for one in reversed(forth)], begin, rejected, tell)[::-1]


def _again(parameters: ModelParameters) -> FrameStart:
    """A start after joints have moved: as in the first frame, a pose but of fingers is known roughly."""
    return FrameStart(parameters.vector(), parameters.pose, first=True)


def _fitted(fitter: FrameFitter, frame: FrameData, begin: FrameStart) -> tuple[ModelParameters | None, str]:
    """One frame's parameters; or why there are none."""
    options = fitter.options
    steps = options.first if begin.first else options.annealing
    solution = fitter.fit(frame.points, replace(begin, back=frame.back), steps)
    if not solution.outcome.usable:
        return None, f"the fit {solution.outcome.value}"
    # Fingers that have lost their scan are not looked for here: with shape and arms not known yet, two hands
    # of four began stage two worse for it.
    vector = solution.state.parameters
    status, reason = judged(fitter.measured(frame.points, vector), options.bounds)
    return (None, reason) if status == "failed" else (fitter.fields.parameters(vector), "")


def _unposed(fitter: FrameFitter, one: FittedFrame) -> Float[np.ndarray, "V 3"]:
    """The template that a frame's free vertices speak for.

    Raises:
        ArithmeticError: they are not determined.
    """
    posed = fitter.fields.evaluated(one.parameters.vector()).vertices
    free = fitter.freed(one.data.points, posed, fitter.options.template_free)
    return unposed(fitter.model, free, one.parameters)


def _averaged(
    fitter: FrameFitter, followed: Sequence[FittedFrame], rejected: dict[str, str]
) -> tuple[Float[np.ndarray, "V 3"], list[FittedFrame]]:
    """The mean of the frames' templates, and the frames that are in it."""
    kept, found = [], []
    for one in followed:
        try:
            found.append(_unposed(fitter, one))
            kept.append(one)
        except ArithmeticError as error:
            rejected[one.data.name] = f"free vertices: {error}"
    if not kept:
        raise TemplateError(f"no frame could be used for the subject's template: {rejected}")
    templates = np.array(found)
    median = np.median(templates, axis=0)
    spread = np.percentile(np.linalg.norm(templates - median, axis=2), 95, axis=1)
    good = spread <= _UNPOSED_P95
    for index in np.flatnonzero(~good):
        rejected[kept[index].data.name] = (
            f"badly unposed: a twentieth of the vertices is over {1e3 * spread[index]:.1f} mm from the median"
        )
    if not good.any():
        raise TemplateError("every frame was badly unposed; is the motion at the start too fast?")
    return templates[good].mean(axis=0), [kept[index] for index in np.flatnonzero(good)]
