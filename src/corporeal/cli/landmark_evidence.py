"""Where a scan's landmarks come from: the user's file, the detector, or nowhere."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from corporeal.cli.errors import CommandError
from corporeal.model.surface_model import SurfaceModel
from corporeal.registration.register import LandmarkEvidence
from corporeal.scans.detector import DetectorMissingError, HandDetector
from corporeal.scans.landmark_files import LandmarkFileError, read_landmarks
from corporeal.scans.landmarks import find_hand_landmarks
from corporeal.scans.scan import Scan

_SETS_FOR_DETECTOR = ("hand_21_detector", "hand_21_mediapipe")
_SETS_FOR_USERS = ("hand_21_mediapipe",)


class LandmarkFinder:
    """Finds landmarks for scans of one run; the user's file always wins."""

    def __init__(self, model: SurfaceModel, file: Path | None) -> None:
        self._model = model
        self._detector: HandDetector | None = None
        self._given: dict[str, np.ndarray] | None = None
        if file is not None:
            try:
                self._given = read_landmarks(file)
            except (LandmarkFileError, OSError) as error:
                raise CommandError(str(error), 2) from error

    def find(self, scan: Scan) -> tuple[LandmarkEvidence | None, list[str]]:
        """Evidence or None, and sentences that say what was done."""
        if self._given is not None:
            return self._of_user(scan, self._given), ["landmarks taken from the file given"]
        set_name = next((name for name in _SETS_FOR_DETECTOR if name in self._model.landmarks), None)
        if set_name is None:
            return None, ["the model has no hand landmarks: orientation and side found by search"]
        try:
            if self._detector is None:
                self._detector = HandDetector()
            found = find_hand_landmarks(scan, self._detector)
        except DetectorMissingError as error:
            return None, [f"{error}; orientation and side found by search"]
        if not found.ok:
            return None, [f"{found.reason}; orientation and side found by search"]
        positions = dict(zip(found.names, found.points, strict=True))
        spread = np.maximum(found.spread_m / np.median(found.spread_m), 0.5)
        sigmas = {name: float(value) for name, value in zip(found.names, spread, strict=True)}
        notes = [f"landmarks from {found.views_used} virtual views"]
        if set_name != _SETS_FOR_DETECTOR[0]:
            notes.append("the model's joints stand in for the detector's landmarks: it was not calibrated")
        return LandmarkEvidence(positions, sigmas, found.side_score, set_name), notes

    def _of_user(self, scan: Scan, given: dict[str, np.ndarray]) -> LandmarkEvidence:
        set_name = next((name for name in _SETS_FOR_USERS if name in self._model.landmarks), None)
        if set_name is None:
            raise CommandError("--landmarks: the model has no landmark set of a hand", 2)
        known = self._model.landmarks[set_name].names
        unknown = sorted(set(given) - set(known))
        if unknown:
            raise CommandError(f"--landmarks: {unknown[0]!r} is not one of {', '.join(known)}", 2)
        if len(given) < 4:
            raise CommandError(f"--landmarks: at least 4 landmarks are needed, {len(given)} are given", 2)
        positions = {name: point * scan.unit.metres_per_unit for name, point in given.items()}
        return LandmarkEvidence(positions, {}, 0.5, set_name)
