"""The 2D hand detector: mediapipe, an optional extra, behind small classes."""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
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

# The grey of a picture without a hand.
_NOTHING = 110


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


class Network:
    """One of mediapipe's solutions, kept from writing to the terminal; close it when done."""

    def __init__(self, make: Callable[[], Any]) -> None:
        """Load it.

        Args:
            make: imports and builds the solution.

        Raises:
            DetectorMissingError: mediapipe is not installed.
        """
        with _silence():
            try:
                self._solution: Any = make()
            except ImportError as error:
                sentence = 'the detector is not installed (pip install "corporeal[detect]")'
                if not (error.name or "").startswith("mediapipe"):
                    sentence = f"the detector cannot be loaded: {error}"
                raise DetectorMissingError(sentence) from error
            # The landmark network logs once more when it meets its first subject.
            self._has_spoken = False
            # Its threads go on loading, and logging, until the first picture is through.
            self._solution.process(np.zeros((192, 192, 3), np.uint8))

    def __call__(self, picture: UInt8[np.ndarray, "H W 3"]) -> Any:
        """What the solution answers to an RGB picture."""
        with _no_warnings() if self._has_spoken else _silence():
            return self._solution.process(picture)

    def has_found(self) -> None:
        """To be told of the first find: after it nothing more is logged."""
        self._has_spoken = True

    def close(self) -> None:
        """Let go of it."""
        with _silence():
            self._solution.close()


class HandDetector:
    """Finds at most one hand in a picture; use it in a ``with`` block."""

    def __init__(self, minimum_confidence: float = 0.3) -> None:
        """Load the detector's weights from its wheel.

        Raises:
            DetectorMissingError: mediapipe is not installed.
        """

        def make(each_alone: bool) -> Any:
            from mediapipe.python.solutions.hands import Hands

            return Hands(
                static_image_mode=each_alone, max_num_hands=1, min_detection_confidence=minimum_confidence
            )

        self._network = Network(lambda: make(True))
        self._make_following = lambda: make(False)
        self._following: Network | None = None

    def __enter__(self) -> HandDetector:
        return self

    def __exit__(self, *_: object) -> None:
        self._network.close()
        if self._following is not None:
            self._following.close()

    def detect(self, picture: UInt8[np.ndarray, "H W 3"]) -> DetectedHand | None:
        """The hand in an RGB picture, or None."""
        return _hand_seen(self._network, picture)

    def followed(self, pictures: Sequence[UInt8[np.ndarray, "H W 3"]]) -> list[DetectedHand | None]:
        """The hand in RGB pictures of one size that frame it alike: looked for where the one before has it.

        Answers depend on these pictures alone, not on what was asked before.
        """
        if self._following is None:
            self._following = Network(self._make_following)
        if len(pictures):
            # Nothing is to be seen where the last hand was: it is forgotten.
            self._following(np.full_like(pictures[0], _NOTHING))
        return [_hand_seen(self._following, picture) for picture in pictures]


def _hand_seen(network: Network, picture: UInt8[np.ndarray, "H W 3"]) -> DetectedHand | None:
    result = network(picture)
    if not result.multi_hand_landmarks:
        return None
    network.has_found()
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
