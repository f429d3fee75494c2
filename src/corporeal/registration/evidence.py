"""Landmarks of a scan: the user's file, the detector, or nowhere."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from corporeal.model.surface_model import SurfaceModel
from corporeal.registration.subjects import BODY, HEAD, subject_of
from corporeal.scans.body_detector import BodyDetector
from corporeal.scans.body_landmarks import BodyLandmarks, find_body_landmarks
from corporeal.scans.detector import DetectorMissingError, HandDetector
from corporeal.scans.face_detector import FaceDetector
from corporeal.scans.face_landmarks import FaceLandmarks, find_face_landmarks
from corporeal.scans.formats.landmarks import read_landmarks
from corporeal.scans.landmarks import HandLandmarks, find_hand_landmarks
from corporeal.scans.scan import Scan

_FEWEST_GIVEN = 4


@dataclass(frozen=True, eq=False)
class LandmarkEvidence:
    """Landmarks of a scan as found or given.

    Attributes:
        positions: landmark name -> (3,) metres, in the scan's frame.
        sigmas: landmark name -> standard deviation relative to the others; 1 where it has no entry.
        right_probability: how likely it is a right hand; 0.5 where nothing is known.
        set_name: which of the model's landmark sets the names belong to.
    """

    positions: Mapping[str, np.ndarray]
    sigmas: Mapping[str, float]
    right_probability: float
    set_name: str


class LandmarkFinder:
    """Finds landmarks for scans of one run; the user's file always wins. Use it in a ``with`` block."""

    def __init__(self, model: SurfaceModel, file: Path | None = None) -> None:
        """Prepare for one model; detectors are loaded at the first scan that needs them.

        Raises:
            ValueError: the landmark file cannot be read, has names that the model does not know, or fewer
                than four landmarks.
        """
        self._model = model
        self._subject = subject_of(model)
        self._detectors = ExitStack()
        self._hands: HandDetector | None = None
        self._bodies: BodyDetector | None = None
        self._faces: FaceDetector | None = None
        self._given: dict[str, np.ndarray] | None = None
        if file is not None:
            self._given = read_landmarks(file)
            _check_given(file, self._given, model, self._subject.given_set)

    def __enter__(self) -> LandmarkFinder:
        return self

    def __exit__(self, *_: object) -> None:
        self._detectors.close()
        self._hands = self._bodies = self._faces = None

    @property
    def set_name(self) -> str | None:
        """The model's landmark set that the detector's landmarks belong to; None if it has none."""
        return self._subject.detector_set(self._model)

    def find(self, scan: Scan) -> tuple[LandmarkEvidence | None, list[str]]:
        """Evidence or None, and sentences that say what was done."""
        if self._given is not None:
            return self._of_user(scan, self._given), ["landmarks taken from the file given"]
        set_name = self.set_name
        if set_name is None:
            return None, ["the model has no landmarks that a detector finds: orientation and side by search"]
        try:
            found = self._found(scan)
        except DetectorMissingError as error:
            return None, [f"{error}; orientation and side found by search"]
        if not found.ok:
            return None, [f"{found.reason}; orientation and side found by search"]
        known = set(self._model.landmarks[set_name].names)
        spread = np.maximum(found.spread_m / np.median(found.spread_m), 0.5)
        points = {
            name: (point, float(sigma))
            for name, point, sigma in zip(found.names, found.points, spread, strict=True)
            if name in known
        }
        notes = [f"landmarks from {found.views_used} virtual views"]
        if isinstance(found, BodyLandmarks):
            seen = " and ".join(found.hands) or "neither"
            notes.append(f"hands whose fingers were seen: {seen}")
        if set_name != self._subject.detector_sets[0]:
            notes.append("the model's joints stand in for the detector's landmarks: it was not calibrated")
        positions = {name: point for name, (point, _) in points.items()}
        sigmas = {name: sigma for name, (_, sigma) in points.items()}
        side_score = found.side_score if isinstance(found, HandLandmarks) else 0.5
        return LandmarkEvidence(positions, sigmas, side_score, set_name), notes

    def _found(self, scan: Scan) -> HandLandmarks | BodyLandmarks | FaceLandmarks:
        if self._subject is HEAD:
            if self._faces is None:
                self._faces = self._detectors.enter_context(FaceDetector())
            return find_face_landmarks(scan, self._faces)
        if self._hands is None:
            self._hands = self._detectors.enter_context(HandDetector())
        if self._subject is not BODY:
            return find_hand_landmarks(scan, self._hands)
        if self._bodies is None:
            self._bodies = self._detectors.enter_context(BodyDetector())
        return find_body_landmarks(scan, self._bodies, self._hands)

    def _of_user(self, scan: Scan, given: Mapping[str, np.ndarray]) -> LandmarkEvidence:
        positions = {name: point * scan.unit.metres_per_unit for name, point in given.items()}
        return LandmarkEvidence(positions, {}, 0.5, self._subject.given_set)


def _check_given(file: Path, given: Mapping[str, np.ndarray], model: SurfaceModel, set_name: str) -> None:
    if set_name not in model.landmarks:
        raise ValueError(f"{file.name}: the model {model.name!r} has no landmarks {set_name!r} to compare")
    known = model.landmarks[set_name].names
    unknown = sorted(set(given) - set(known))
    if unknown:
        raise ValueError(f"{file.name}: {unknown[0]!r} is not one of {', '.join(known)}")
    if len(given) < _FEWEST_GIVEN:
        raise ValueError(f"{file.name}: at least {_FEWEST_GIVEN} landmarks are needed, it holds {len(given)}")
