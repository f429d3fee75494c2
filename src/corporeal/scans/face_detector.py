"""The 2D detector of faces: mediapipe's face mesh behind one small class."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float, UInt8

from corporeal.scans.detector import Network

FACE_NAMES = (
    *(f"right_brow_{k}" for k in (1, 2, 3, 4, 5)),
    *(f"left_brow_{k}" for k in (5, 4, 3, 2, 1)),
    *(f"nose_bridge_{k}" for k in (1, 2, 3, 4)),
    "right_nostril_outer", "right_nostril_inner", "nose_base", "left_nostril_inner", "left_nostril_outer",
    "right_eye_outer", "right_eye_upper_outer", "right_eye_upper_inner", "right_eye_inner",
    "right_eye_lower_inner", "right_eye_lower_outer",
    "left_eye_inner", "left_eye_upper_inner", "left_eye_upper_outer", "left_eye_outer",
    "left_eye_lower_outer", "left_eye_lower_inner",
    "right_mouth_corner", "right_lip_top_2", "right_lip_top_1", "lip_top", "left_lip_top_1", "left_lip_top_2",
    "left_mouth_corner", "left_lip_bottom_2", "left_lip_bottom_1", "lip_bottom", "right_lip_bottom_1",
    "right_lip_bottom_2",
    "right_mouth_inner_corner", "right_mouth_top", "mouth_top", "left_mouth_top", "left_mouth_inner_corner",
    "left_mouth_bottom", "mouth_bottom", "right_mouth_bottom",
)  # fmt: skip
"""The 51 landmarks by the names of the landmark set "face": iBUG's 68 without the outline."""

# Which of the 468 points of the face mesh they are.
_POINTS = (
    70, 63, 105, 66, 107, 336, 296, 334, 293, 300,
    168, 197, 5, 4, 98, 97, 2, 326, 327,
    33, 160, 158, 133, 153, 144, 362, 385, 387, 263, 373, 380,
    61, 39, 37, 0, 267, 269, 291, 405, 314, 17, 84, 181,
    78, 82, 13, 312, 308, 317, 14, 87,
)  # fmt: skip


class FaceDetector:
    """Finds at most one face in a picture; use it in a ``with`` block."""

    def __init__(self, minimum_confidence: float = 0.3) -> None:
        """Load the detector's weights from its wheel.

        Raises:
            DetectorMissingError: mediapipe is not installed.
        """

        def make() -> Any:
            from mediapipe.python.solutions.face_mesh import FaceMesh

            return FaceMesh(
                static_image_mode=True, max_num_faces=1, min_detection_confidence=minimum_confidence
            )

        self._network = Network(make)

    def __enter__(self) -> FaceDetector:
        return self

    def __exit__(self, *_: object) -> None:
        self._network.close()

    def detect(self, picture: UInt8[np.ndarray, "H W 3"]) -> Float[np.ndarray, "51 2"] | None:
        """Landmarks of the face in an RGB picture in pixels from the top left corner, or None."""
        result = self._network(picture)
        if result.multi_face_landmarks is None:
            return None
        self._network.has_found()
        height, width = picture.shape[:2]
        marks = result.multi_face_landmarks[0].landmark
        return np.array([[marks[point].x * width, marks[point].y * height] for point in _POINTS])
