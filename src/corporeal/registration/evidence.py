"""Landmarks of a scan: the user's file, the detector, or nowhere."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from corporeal.model.surface_model import SurfaceModel
from corporeal.scans.detector import DetectorMissingError, HandDetector
from corporeal.scans.formats.landmarks import read_landmarks
from corporeal.scans.landmarks import find_hand_landmarks
from corporeal.scans.scan import Scan

_SETS_FOR_DETECTOR = ("hand_21_detector", "hand_21_mediapipe")
_SET_FOR_USERS = "hand_21_mediapipe"
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
        """Prepare for one model; the detector is loaded at the first scan that needs it.

        Raises:
            ValueError: the landmark file cannot be read, has names that the model does not know, or fewer
                than four landmarks.
        """
        self._model = model
        self._detector: HandDetector | None = None
        self._given: dict[str, np.ndarray] | None = None
        if file is not None:
            self._given = read_landmarks(file)
            _check_given(file, self._given, model)

    def __enter__(self) -> LandmarkFinder:
        return self

    def __exit__(self, *_: object) -> None:
        if self._detector is not None:
            self._detector.__exit__()
            self._detector = None

    @property
    def set_name(self) -> str | None:
        """The model's landmark set that the detector's landmarks belong to; None if it has none."""
        return next((name for name in _SETS_FOR_DETECTOR if name in self._model.landmarks), None)

    def find(self, scan: Scan) -> tuple[LandmarkEvidence | None, list[str]]:
        """Evidence or None, and sentences that say what was done."""
        if self._given is not None:
            return self._of_user(scan, self._given), ["landmarks taken from the file given"]
        set_name = self.set_name
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

    def _of_user(self, scan: Scan, given: Mapping[str, np.ndarray]) -> LandmarkEvidence:
        positions = {name: point * scan.unit.metres_per_unit for name, point in given.items()}
        return LandmarkEvidence(positions, {}, 0.5, _SET_FOR_USERS)


def _check_given(file: Path, given: Mapping[str, np.ndarray], model: SurfaceModel) -> None:
    if _SET_FOR_USERS not in model.landmarks:
        raise ValueError(f"{file.name}: the model {model.name!r} has no landmarks of a hand to compare with")
    known = model.landmarks[_SET_FOR_USERS].names
    unknown = sorted(set(given) - set(known))
    if unknown:
        raise ValueError(f"{file.name}: {unknown[0]!r} is not one of {', '.join(known)}")
    if len(given) < _FEWEST_GIVEN:
        raise ValueError(f"{file.name}: at least {_FEWEST_GIVEN} landmarks are needed, it holds {len(given)}")
