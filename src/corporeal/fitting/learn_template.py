"""Stage one of tracking: a subject's template from the first frames (Romero et al. 2017, section 4.3.1)."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
from jaxtyping import Float

from corporeal.fitting.frame_data import frame_points
from corporeal.fitting.frame_fit import FrameFitter, FrameStart, scan_surface
from corporeal.fitting.options import HandPose, TrackingOptions
from corporeal.fitting.subject_template import SubjectTemplate, personal_model
from corporeal.fitting.track import judged
from corporeal.fitting.unposing import unposed
from corporeal.model.surface_model import SurfaceModel
from corporeal.scans.scan import Scan
from corporeal.terms.model_fields import ModelParameters

# A frame is badly unposed where more than a twentieth of its vertices lies farther than this from the median
# of all frames: in place of the paper's look at each.
_UNPOSED_P95 = 8e-3


class TemplateError(ValueError):
    """No frame of a sequence could be used for a subject's template."""


@dataclass(frozen=True, eq=False)
class _Aligned:
    name: str
    template: Float[np.ndarray, "V 3"]
    parameters: ModelParameters


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
        on_step: told each frame's name.

    Raises:
        TemplateError: no frame could be used.
    """
    options = options or TrackingOptions()
    plain = model.replace(expression_directions=np.zeros((model.vertex_count, 3, 0)))
    # Six components do not reach every fist, and what the pose cannot say the template would.
    hands: HandPose = "flat" if options.hands == "flat" else "full"
    fitter = FrameFitter(
        plain, replace(options, hands=hands), shape_count=min(options.shape_count, plain.shape_count)
    )
    aligned: list[_Aligned] = []
    rejected: dict[str, str] = {}
    vector = _started(fitter, start)
    for name, scan in islice(frames, options.template_frames):
        if on_step is not None:
            on_step(name)
        if scan is None or len(scan.points) < options.bounds.fewest_points:
            rejected[name] = "no scan, or too few points"
            continue
        found, reason = _aligned(fitter, scan, name, vector, [one.parameters.shape for one in aligned])
        if found is None:
            rejected[name] = reason
            continue
        vector = found.parameters.vector()
        aligned.append(found)
    return _averaged(model, aligned, rejected)


def _started(fitter: FrameFitter, start: ModelParameters) -> Float[np.ndarray, " Q"]:
    shape = np.zeros(fitter.fields.shape_count)
    given = start.shape[: len(shape)]
    shape[: len(given)] = given
    return ModelParameters(start.translation, start.pose, shape).vector()


def _aligned(
    fitter: FrameFitter, scan: Scan, name: str, vector: Float[np.ndarray, " Q"], shapes: list[np.ndarray]
) -> tuple[_Aligned | None, str]:
    """One frame fitted, its free vertices unposed; or why not."""
    options, first = fitter.options, not shapes
    points = frame_points(scan, options)
    back = scan_surface(scan)
    if first:
        begin = FrameStart(vector, first=True, back=back)
    else:
        previous = fitter.fields.parameters(vector).pose
        begin = FrameStart(vector, previous, back=back, shape=np.mean(shapes, axis=0), shapes=len(shapes))
    solution = fitter.fit(points, begin, options.first if first else options.annealing)
    if not solution.outcome.usable:
        return None, f"the fit {solution.outcome.value}"
    measures = fitter.measured(points, solution.state.parameters)
    status, reason = judged(measures, options.bounds)
    if status == "failed":
        return None, reason
    parameters = fitter.fields.parameters(solution.state.parameters)
    posed = fitter.fields.evaluated(solution.state.parameters).vertices
    try:
        free = fitter.freed(points, posed, options.template_free)
    except ArithmeticError as error:
        return None, f"free vertices: {error}"
    return _Aligned(name, unposed(fitter.model, free, parameters), parameters), ""


def _averaged(model: SurfaceModel, aligned: list[_Aligned], rejected: dict[str, str]) -> SubjectTemplate:
    if not aligned:
        raise TemplateError(f"no frame could be used for the subject's template: {rejected}")
    templates = np.array([one.template for one in aligned])
    median = np.median(templates, axis=0)
    spread = np.percentile(np.linalg.norm(templates - median, axis=2), 95, axis=1)
    good = spread <= _UNPOSED_P95
    for index in np.flatnonzero(~good):
        rejected[aligned[index].name] = (
            f"badly unposed: a twentieth of the vertices is over {1e3 * spread[index]:.1f} mm from the median"
        )
    if not good.any():
        raise TemplateError("every frame was badly unposed; is the motion at the start too fast?")
    first = aligned[0].parameters
    used = tuple(one.name for one, kept in zip(aligned, good, strict=True) if kept)
    personal = personal_model(model, templates[good].mean(axis=0))
    return SubjectTemplate(personal, first.shape, used, rejected, first.pose, first.translation)
