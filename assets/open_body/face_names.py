"""Names of the 68 face landmarks in iBUG's order, and where MediaPipe's face mesh has them."""

from __future__ import annotations

_JAW = [*(f"right_jaw_{k}" for k in range(1, 9)), "chin", *(f"left_jaw_{k}" for k in range(8, 0, -1))]
_BROWS = [*(f"right_brow_{k}" for k in range(1, 6)), *(f"left_brow_{k}" for k in range(5, 0, -1))]
_NOSE = [f"nose_bridge_{k}" for k in range(1, 5)]
_NOSTRILS = [
    "right_nostril_outer",
    "right_nostril_inner",
    "nose_base",
    "left_nostril_inner",
    "left_nostril_outer",
]
_RIGHT_EYE = [
    f"right_eye_{part}"
    for part in ("outer", "upper_outer", "upper_inner", "inner", "lower_inner", "lower_outer")
]
_LEFT_EYE = [
    f"left_eye_{part}"
    for part in ("inner", "upper_inner", "upper_outer", "outer", "lower_outer", "lower_inner")
]
_LIPS = [
    "right_mouth_corner", "right_lip_top_2", "right_lip_top_1", "lip_top", "left_lip_top_1", "left_lip_top_2",
    "left_mouth_corner", "left_lip_bottom_2", "left_lip_bottom_1", "lip_bottom", "right_lip_bottom_1",
    "right_lip_bottom_2",
]  # fmt: skip
_MOUTH = [
    "right_mouth_inner_corner", "right_mouth_top", "mouth_top", "left_mouth_top", "left_mouth_inner_corner",
    "left_mouth_bottom", "mouth_bottom", "right_mouth_bottom",
]  # fmt: skip
FACE_68 = (*_JAW, *_BROWS, *_NOSE, *_NOSTRILS, *_RIGHT_EYE, *_LEFT_EYE, *_LIPS, *_MOUTH)
# Vertices of MediaPipe's canonical face mesh.
MEDIAPIPE_OF_68 = (
    162, 234, 93, 58, 172, 136, 149, 148, 152, 377, 378, 365, 397, 288, 323, 454, 389, 71, 63, 105, 66,
    107, 336, 296, 334, 293, 301, 168, 197, 5, 4, 75, 97, 2, 326, 305, 33, 160, 158, 133, 153, 144, 362,
    385, 387, 263, 373, 380, 61, 39, 37, 0, 267, 269, 291, 405, 314, 17, 84, 181, 78, 82, 13, 312, 308,
    317, 14, 87,
)  # fmt: skip


def other_side(name: str) -> str:
    """The name of the landmark on the other side; of one in the middle, its own."""
    for one, two in (("left_", "right_"), ("right_", "left_")):
        if name.startswith(one):
            return two + name.removeprefix(one)
    return name
