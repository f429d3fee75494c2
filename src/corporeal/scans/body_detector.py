"""The 2D detector of whole people: mediapipe's pose network behind one small class."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int, UInt8

from corporeal.scans.detector import Network

_SIDED = (
    "shoulder", "elbow", "wrist", "pinky", "index", "thumb", "hip", "knee", "ankle", "heel", "big_toe",
)  # fmt: skip
BODY_NAMES = (
    "nose", "left_eye_inner", "left_eye", "left_eye_outer", "right_eye_inner", "right_eye", "right_eye_outer",
    "left_ear", "right_ear", "left_mouth_corner", "right_mouth_corner",
    *(f"{side}_{part}" for part in _SIDED for side in ("left", "right")),
)  # fmt: skip
"""MediaPipe's 33 landmarks of a body in its order, by the names of the landmark set "mediapipe_33"."""


def _swapped() -> Int[np.ndarray, " 33"]:
    def other(name: str) -> str:
        return name.replace("left", "RIGHT").replace("right", "left").replace("RIGHT", "right")

    return np.array([BODY_NAMES.index(other(name)) for name in BODY_NAMES])


LEFT_RIGHT = _swapped()
"""(33,) the landmark of the other side; those of the middle are their own."""


@dataclass(frozen=True, eq=False)
class DetectedBody:
    """A person in one picture.

    Attributes:
        pixels: (33, 2) landmarks in MediaPipe's order, pixels, origin at the top left corner.
        visibility: (33,) how sure the detector is that a landmark is seen, 0 to 1.
    """

    pixels: Float[np.ndarray, "33 2"]
    visibility: Float[np.ndarray, " 33"]


class BodyDetector:
    """Finds at most one person in a picture; use it in a ``with`` block."""

    def __init__(self, minimum_confidence: float = 0.3) -> None:
        """Load the detector's weights from its wheel.

        Raises:
            DetectorMissingError: mediapipe is not installed.
        """

        def make() -> Any:
            from mediapipe.python.solutions.pose import Pose

            # The heavier network is fetched from the net at run time; this one is in the wheel.
            return Pose(
                static_image_mode=True, model_complexity=1, min_detection_confidence=minimum_confidence
            )

        self._network = Network(make)

    def __enter__(self) -> BodyDetector:
        return self

    def __exit__(self, *_: object) -> None:
        self._network.close()

    def detect(self, picture: UInt8[np.ndarray, "H W 3"]) -> DetectedBody | None:
        """The person in an RGB picture, or None."""
        result = self._network(picture)
        if result.pose_landmarks is None:
            return None
        self._network.has_found()
        height, width = picture.shape[:2]
        marks = result.pose_landmarks.landmark
        pixels = np.array([[mark.x * width, mark.y * height] for mark in marks])
        return DetectedBody(pixels, np.array([mark.visibility for mark in marks]))
