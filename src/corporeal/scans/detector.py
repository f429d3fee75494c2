"""The 2D hand detector: mediapipe, an optional extra, behind one small class."""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8

LANDMARK_NAMES = (
    "wrist",
    *(f"thumb_{part}" for part in ("cmc", "mcp", "ip", "tip")),
    *(
        f"{finger}_{part}"
        for finger in ("index", "middle", "ring", "little")
        for part in ("mcp", "pip", "dip", "tip")
    ),
)


class DetectorMissingError(ImportError):
    """The optional detector is not installed, or a library that it needs is missing."""


@dataclass(frozen=True, eq=False)
class DetectedHand:
    """A hand in one picture.

    Attributes:
        pixels: (21, 2) landmarks in MediaPipe's order, pixels, origin at the top left corner.
        right_probability: how likely it is a right hand.
        confidence: how sure the detector is of its side, 0.5 to 1.
    """

    pixels: Float[np.ndarray, "21 2"]
    right_probability: float
    confidence: float


class HandDetector:
    """Finds at most one hand in a picture; use it in a ``with`` block."""

    def __init__(self, minimum_confidence: float = 0.3) -> None:
        """Load the detector's weights from its wheel.

        Raises:
            DetectorMissingError: mediapipe is not installed.
        """
        with _silence():
            try:
                from mediapipe.python.solutions.hands import Hands
            except ImportError as error:
                sentence = 'the hand detector is not installed (pip install "corporeal[detect]")'
                if not (error.name or "").startswith("mediapipe"):
                    sentence = f"the hand detector cannot be loaded: {error}"
                raise DetectorMissingError(sentence) from error
            self._hands: Any = Hands(
                static_image_mode=True, max_num_hands=1, min_detection_confidence=minimum_confidence
            )
            # The landmark network logs once more when it meets its first hand.
            self._has_spoken = False
            # Its threads go on loading, and logging, until the first picture is through.
            self._hands.process(np.zeros((192, 192, 3), np.uint8))

    def __enter__(self) -> HandDetector:
        return self

    def __exit__(self, *_: object) -> None:
        with _silence():
            self._hands.close()

    def detect(self, picture: UInt8[np.ndarray, "H W 3"]) -> DetectedHand | None:
        """The hand in an RGB picture, or None."""
        with _no_warnings() if self._has_spoken else _silence():
            result = self._hands.process(picture)
        if not result.multi_hand_landmarks:
            return None
        self._has_spoken = True
        marks = result.multi_hand_landmarks[0].landmark
        label = result.multi_handedness[0].classification[0]
        height, width = picture.shape[:2]
        pixels = np.array([[mark.x * width, mark.y * height] for mark in marks])
        # The detector speaks of mirrored selfie pictures: what it calls left is a right hand here.
        right = float(label.score if label.label == "Left" else 1 - label.score)
        return DetectedHand(pixels, right, float(label.score))


@contextmanager
def _no_warnings() -> Iterator[None]:
    """Keep the deprecation warnings of the detector's libraries out of ours."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


@contextmanager
def _silence() -> Iterator[None]:
    """Keep the detector's C++ log off the terminal too: it writes to the file descriptor, past Python."""
    sys.stderr.flush()
    saved, nothing = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nothing, 2)
        with _no_warnings():
            yield
    finally:
        os.dup2(saved, 2)
        os.close(saved)
        os.close(nothing)
