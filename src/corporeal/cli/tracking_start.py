"""How tracking begins: a person is registered in a first frame, then the template is learned."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from corporeal.cli.tracking_folder import stamp_of
from corporeal.fitting.learn_template import TemplateError, learn_subject_template
from corporeal.fitting.options import TrackingOptions
from corporeal.fitting.subject_template import SubjectTemplate, personal_model
from corporeal.model.surface_model import SurfaceModel
from corporeal.registration.evidence import LandmarkFinder
from corporeal.registration.register import register
from corporeal.registration.registration import FailedRegistration
from corporeal.registration.session.files import sha256_of
from corporeal.registration.subjects import subject_of
from corporeal.scans.files import ScanFileError, read_scan
from corporeal.scans.formats.sequence import ScanSequence, SequenceFrame
from corporeal.scans.scan import Scan
from corporeal.scans.units import UnitChoice
from corporeal.terms.model_fields import ModelParameters

# Neighbours look alike: where five frames show no person, the sixth will not either.
_TRIES = 5


class SequenceError(ValueError):
    """A sequence cannot be tracked at all; the message says why."""


@dataclass(frozen=True, eq=False)
class ReadFrame:
    """A frame's scan, or why there is none, and what its file was then."""

    scan: Scan | None
    reason: str
    sha256: str | None
    stamp: tuple[int, int] | None


@dataclass(frozen=True, eq=False)
class SequenceStart:
    """Where a sequence starts.

    Attributes:
        index: of the frame.
        parameters: of the person in it.
        unit: of its file: that of all others, which may be too broken to tell.
        story: how they were found, of JSON's types.
        skipped: name -> why an earlier frame could not be the first.
    """

    index: int
    parameters: ModelParameters
    unit: UnitChoice
    story: dict[str, Any]
    skipped: dict[str, str] = field(default_factory=dict)


def read_frame_scan(frame: SequenceFrame, model: SurfaceModel, unit: UnitChoice) -> ReadFrame:
    """Read a frame; one that cannot be read costs itself only."""
    # Before it is read: should it change between the two, a resumed run tracks it again.
    stamp, sha256 = stamp_of(frame.path), sha256_of(frame.path)
    try:
        scan, reason = read_scan(frame.path, unit, subject_of(model).extent), ""
    except ScanFileError as error:
        scan, reason = None, str(error)
    return ReadFrame(scan, reason, sha256, stamp)


def first_frame(
    sequence: ScanSequence, model: SurfaceModel, options: TrackingOptions, start: ModelParameters | None,
    on_step: Callable[[str], None],
) -> SequenceStart:  # fmt: skip
    """Register the person in the first frame that can be read and shows one.

    Args:
        sequence: what is tracked.
        model: that is registered.
        options: of tracking.
        start: parameters in the first frame with a scan, if they are known; then nothing is registered.
        on_step: told what is done.

    Raises:
        SequenceError: no frame can be read, or no person can be registered.
    """
    skipped: dict[str, str] = {}
    tries = 0
    with LandmarkFinder(model) as finder:
        for index, frame in enumerate(sequence.frames):
            read = read_frame_scan(frame, model, sequence.unit)
            scan = read.scan
            if scan is None or len(scan.points) < options.bounds.fewest_points:
                skipped[frame.name] = read.reason or f"too few points: {len(scan.points) if scan else 0}"
                continue
            if start is not None:
                story = {"frame": frame.name, "given": True}
                return SequenceStart(index, start, scan.unit.name, story, skipped)
            found = _registered(frame.name, scan, model, finder, on_step)
            if isinstance(found, SequenceStart):
                return dataclasses.replace(found, index=index, skipped=skipped)
            skipped[frame.name], tries = found, tries + 1
            if tries == _TRIES:
                break
    if not tries:
        name, reason = next(iter(skipped.items()))
        raise SequenceError(f"no frame can be read; {name}: {reason}")
    name, reason = next((name, reason) for name, reason in skipped.items() if reason.startswith("not regis"))
    raise SequenceError(
        f"no person could be registered in the first {tries} frames with a scan; {name}: {reason}"
    )


def _registered(
    name: str, scan: Scan, model: SurfaceModel, finder: LandmarkFinder, on_step: Callable[[str], None]
) -> SequenceStart | str:
    """The start that a frame gives, or why it gives none."""
    begun = time.perf_counter()
    on_step(f"registering {name}: landmarks")
    evidence, notes = finder.find(scan)
    result = register(
        scan, model, evidence, None, subject_of(model).options(),
        lambda step: on_step(f"registering {name}: {step}"),
    )  # fmt: skip
    if isinstance(result, FailedRegistration) or result.status == "failed":
        return f"not registered: {result.reason}"
    story = {
        "frame": name,
        "given": False,
        "status": result.status,
        "reason": result.reason,
        "notes": [*scan.repairs, *notes, *result.notes],
        "s2m_mm": result.distances.summary_mm()["mean"],
        "seconds": time.perf_counter() - begun,
    }
    return SequenceStart(0, result.parameters, scan.unit.name, story)


def given_template(model: SurfaceModel, start: SequenceStart) -> SubjectTemplate:
    """The template that was handed over, with the sequence's start."""
    parameters = start.parameters
    personal = personal_model(model, model.template)
    return SubjectTemplate(
        personal, np.zeros(0), (), dict(start.skipped), parameters.pose, parameters.translation
    )


def learned_template(
    sequence: ScanSequence, model: SurfaceModel, options: TrackingOptions, start: SequenceStart,
    on_step: Callable[[str], None],
) -> tuple[SubjectTemplate, dict[str, Any]]:  # fmt: skip
    """Learn the template from the first frames, and say what their files were.

    Raises:
        SequenceError: no frame could be used.
    """
    scans: dict[str, Any] = {}
    reasons: dict[str, str] = {}

    def frames() -> Iterator[tuple[str, Scan | None]]:
        for frame in sequence.frames[start.index :]:
            read = read_frame_scan(frame, model, sequence.unit)
            scans[frame.name] = {"sha256": read.sha256, "stamp": read.stamp or (-1, -1)}
            if read.scan is None:
                reasons[frame.name] = read.reason
            yield frame.name, read.scan

    def said(name: str) -> None:
        on_step(f"template: {name}")

    try:
        found = learn_subject_template(frames(), model, start.parameters, options, said)
    except TemplateError as error:
        raise SequenceError(f"{error} (started from frame {start.story['frame']})") from error
    rejected = {**start.skipped, **{name: reasons.get(name, why) for name, why in found.rejected.items()}}
    used = {name: scans[name] for name in found.used}
    return dataclasses.replace(found, rejected=rejected), used
