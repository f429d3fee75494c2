"""Stage two of tracking: all frames of a sequence with the subject's template, one after the other.

Romero et al. 2017, section 4.3.2. The pose is found with the free vertices of equation 23 held to the model
(lambda_c without bound), then they with the pose held.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int

from corporeal.fitting.arms import SETTLING
from corporeal.fitting.frame_data import FramePoints, frame_points
from corporeal.fitting.frame_fit import FrameFitter, FrameMeasures, FrameStart, HandsAsked, scan_surface
from corporeal.fitting.options import TrackingBounds, TrackingOptions
from corporeal.fitting.pose_terms import is_hand
from corporeal.fitting.subject_template import SubjectTemplate
from corporeal.model.surface_model import SurfaceModel
from corporeal.scans.scan import Scan
from corporeal.terms.surface_to_scan import ScanSurface

Status = Literal["ok", "doubtful", "failed"]


@dataclass(frozen=True, eq=False)
class TrackState:
    """All that the next frame needs of those before.

    Attributes:
        pose: (K, 3) of the last good frame, radians.
        translation: (3,) metres.
        fitted: whether a frame has been fitted yet; before, the numbers are the template's start.
        turned: (K, 3) change of the pose to the last good frame from the one before it; zero where they do
            not follow one another.
        moved: (3,) the same of the translation.
        settling: frames for which each hand's fingers are not looked for, since it was out of sight.
    """

    pose: Float[np.ndarray, "K 3"]
    translation: Float[np.ndarray, "3"]
    fitted: bool
    turned: Float[np.ndarray, "K 3"]
    moved: Float[np.ndarray, "3"]
    settling: Int[np.ndarray, " H"]

    @classmethod
    def at_start(cls, template: SubjectTemplate) -> TrackState:
        """Before the first frame."""
        pose, translation = template.start_pose, template.start_translation
        hands = sum(is_hand(block) for block in template.model.pose_blocks)
        return cls(
            pose, translation, False, np.zeros_like(pose), np.zeros(3), np.zeros(hands, dtype=np.int64)
        )

    def after(
        self,
        pose: Float[np.ndarray, "K 3"],
        translation: Float[np.ndarray, "3"],
        settling: Int[np.ndarray, " H"],
    ) -> TrackState:
        """After one more good frame."""
        turned, moved = pose - self.pose, translation - self.translation
        if not self.fitted:
            turned, moved = np.zeros_like(pose), np.zeros(3)
        return TrackState(pose, translation, True, turned, moved, settling)

    def stopped(self) -> TrackState:
        """After a frame that was lost: nothing is known of the motion any more."""
        return replace(self, turned=np.zeros_like(self.turned), moved=np.zeros(3))

    def vector(self) -> Float[np.ndarray, " Q"]:
        """As parameters of a model without shape."""
        return np.concatenate([self.translation, self.pose.ravel()])

    def predicted(self, moving: Bool[np.ndarray, " K"]) -> Float[np.ndarray, " Q"]:
        """Parameters one frame on, if the joints ``moving`` and the translation go on as they did."""
        pose = self.pose + np.where(moving[:, None], self.turned, 0.0)
        return np.concatenate([self.translation + self.moved, pose.ravel()])


@dataclass(frozen=True, eq=False)
class TrackedFrame:
    """One frame's result.

    Attributes:
        name: of the frame.
        status: "ok", "doubtful", or "failed".
        reason: what is wrong; empty where all is well.
        pose: (K, 3) axis-angle in radians; that of the last good frame where this one failed.
        translation: (3,) metres; likewise.
        s2m_mm: scan to the frame's surface: mean, median, p95 and under_1mm; None where nothing was fitted.
        seconds: by step, and "total".
        signals: shares of the model and of each hand that the scan confirms, near zero where it is missing;
            and of the scan that is "stray", over 6 cm from the model; "model_s2m_mm", its mean distance to
            the model, by which the frame is judged.
        offsets: (V, 3) metres from the posed model's vertices to the frame's surface; None where there are
            no free vertices, and in a frame that failed.
    """

    name: str
    status: Status
    reason: str
    pose: Float[np.ndarray, "K 3"]
    translation: Float[np.ndarray, "3"]
    s2m_mm: dict[str, float] | None
    seconds: dict[str, float]
    signals: dict[str, float]
    offsets: Float[np.ndarray, "V 3"] | None = None


class Tracker:
    """Follows one subject; memory does not grow with the number of frames."""

    def __init__(
        self,
        template: SubjectTemplate,
        options: TrackingOptions | None = None,
        previous: TrackState | None = None,
    ) -> None:
        """Start at the template's start pose, or go on from a state.

        Args:
            template: of the subject.
            options: of tracking.
            previous: state after the frame before, to resume.
        """
        self.options = options or TrackingOptions()
        self.fitter = FrameFitter(template.model, self.options)
        self.state = previous or TrackState.at_start(template)
        self._moving = _body_joints(template.model)

    def step(self, scan: Scan | None, name: str, reason: str = "no scan") -> TrackedFrame:
        """Track the next frame.

        Args:
            scan: of the frame; None where it is missing or cannot be read.
            name: of the frame.
            reason: said of a frame without a scan.
        """
        begun = time.perf_counter()
        fewest = self.options.bounds.fewest_points
        if scan is None:
            return self._lost(name, reason, {"total": time.perf_counter() - begun})
        if len(scan.points) < fewest:
            found = f"the scan has {len(scan.points)} points, expected at least {fewest}"
            return self._lost(name, found, {"total": time.perf_counter() - begun})
        points = frame_points(scan, self.options)
        sampled = time.perf_counter()
        vector, measures, settling = self._fitted(points, scan_surface(scan))
        ended = time.perf_counter()
        seconds = {"sample": sampled - begun, "fit": ended - sampled, "total": ended - begun}
        if measures is None:
            return self._lost(name, "track lost: the scan does not determine a pose", seconds)
        status, verdict = judged(measures, self.options.bounds)
        if status == "failed":
            return self._lost(name, verdict, seconds, measures)
        s2m_mm, offsets = measures.s2m_mm, None
        if self.options.free_vertices:
            posed = self.fitter.fields.evaluated(vector).vertices
            free = self.fitter.freed(points, posed, self.options.frame_free)
            offsets, s2m_mm = free - posed, self.fitter.s2m_mm(points, free)
            freed = time.perf_counter()
            seconds |= {"free": freed - ended, "total": freed - begun}
        parameters = self.fitter.fields.parameters(vector)
        self.state = self.state.after(parameters.pose, parameters.translation, settling)
        return TrackedFrame(
            name, status, verdict, parameters.pose, parameters.translation, s2m_mm, seconds,
            measures.signals, offsets,
        )  # fmt: skip

    def _fitted(
        self, points: FramePoints, back: ScanSurface | None
    ) -> tuple[np.ndarray, FrameMeasures | None, Int[np.ndarray, " H"]]:
        """The frame's parameters, what they explain, and which hands settle; what is lost is tried again."""
        state, options = self.state, self.options
        previous = state.pose if state.fitted else None
        vector = state.predicted(self._moving) if options.predict else state.vector()
        start = FrameStart(vector, previous, first=not state.fitted, back=back)
        steps = options.annealing if state.fitted else options.first
        vector, measures = self._tried(points, start, steps)
        # A second try is not pulled to the last pose, since much time may have passed; but its fingers, and
        # what is not seen, to where it begins.
        for begin in self._elsewhere(points, vector, measures):
            held = self.fitter.fields.parameters(begin).pose if state.fitted else None
            again, other = self._tried(points, FrameStart(begin, held, first=True, back=back), options.retry)
            if measures is None or (other is not None and _better(other, measures)):
                vector, measures = again, other
                if other is not None and other.stray <= options.bounds.stray_share:
                    break
        if measures is None:
            return vector, measures, state.settling
        unseen = self.fitter.unseen_hands(measures)
        settling = np.where(unseen, SETTLING, np.maximum(state.settling - 1, 0))
        # Begun anew in the first frame, and once a hand that was out of sight has settled.
        anew = (settling == 0) & ((state.settling > 0) | (not state.fitted))
        returned = (state.settling == SETTLING) & ~unseen
        asked = HandsAsked(settling == 0, anew, returned, state.pose)
        found = self.fitter.with_fingers(points, vector, start, asked)
        if found is not vector:
            vector, measures = found, self.fitter.measured(points, found)
        return vector, measures, settling

    def _elsewhere(
        self, points: FramePoints, vector: np.ndarray, measures: FrameMeasures | None
    ) -> list[np.ndarray]:
        """Where second tries begin; nothing where none is called for.

        Not for every doubt: in a crouch another person's skin alone may lie over 4 mm off, and what comes
        from farther away has limbs turned by a quarter of a circle to the frame before. But for scan that the
        model is nowhere near while an arm is missing: it has come back somewhere else.
        """
        bounds = self.options.bounds
        if measures is None or not measures.seen["model_seen"] >= bounds.doubtful_share:
            return [self.state.vector()]
        sought = []
        if measures.stray > bounds.stray_share:
            sought = self.fitter.arms_sought(points, vector, measures)
        far = not measures.s2m_mm["mean"] <= bounds.again_mm
        return [self.state.vector()] if far and not sought else sought

    def _tried(
        self, points: FramePoints, start: FrameStart, steps: tuple
    ) -> tuple[np.ndarray, FrameMeasures | None]:
        solution = self.fitter.fit(points, start, steps)
        vector = solution.state.parameters
        if not (solution.outcome.usable and np.isfinite(vector).all()):
            return start.vector, None
        return vector, self.fitter.measured(points, vector)

    def _lost(
        self, name: str, reason: str, seconds: dict[str, float], measures: FrameMeasures | None = None
    ) -> TrackedFrame:
        s2m_mm = None if measures is None else measures.s2m_mm
        signals = {} if measures is None else measures.signals
        state = self.state = self.state.stopped()
        return TrackedFrame(name, "failed", reason, state.pose, state.translation, s2m_mm, seconds, signals)


def judged(measures: FrameMeasures, bounds: TrackingBounds) -> tuple[Status, str]:
    """The verdict on a fitted frame, and what is wrong with it."""
    mean, seen = measures.s2m_mm["mean"], measures.seen["model_seen"]
    far = f"the scan lies {mean:.1f} mm from the model in the mean"
    unseen = f"only {seen:.0%} of the model has scan beside it"
    if not mean <= bounds.failed_mm:
        return "failed", f"track lost: {far}"
    if not seen >= bounds.covered_share:
        return "failed", f"track lost: {unseen}"
    left = f"{measures.stray:.1%} of the scan lies over 6 cm from the model"
    reasons = [far] * (mean > bounds.doubtful_mm) + [unseen] * (seen < bounds.doubtful_share)
    reasons += [left] * (measures.stray > bounds.stray_share)
    return ("doubtful", "; ".join(reasons)) if reasons else ("ok", "")


def _better(other: FrameMeasures, measures: FrameMeasures) -> bool:
    """Whether a further try is clearly better, or has found what was left over at no cost."""
    found = other.stray < 0.5 * measures.stray and other.s2m_mm["mean"] <= measures.s2m_mm["mean"]
    return found or _badness(other) < 0.8 * _badness(measures)


def _badness(measures: FrameMeasures) -> float:
    """Distance per share confirmed: neither alone tells a good fit."""
    return measures.s2m_mm["mean"] / max(measures.seen["model_seen"], 1e-3)


def _body_joints(model: SurfaceModel) -> Bool[np.ndarray, " K"]:
    """Joints whose motion is extrapolated: all but the fingers, which stop and turn within a few frames."""
    moving = np.ones(model.joint_count, dtype=bool)
    for block in model.pose_blocks:
        if is_hand(block):
            moving[list(block.joints)] = False
    return moving
