"""What kinds of subject there are to register: records of data that a model's landmarks choose among."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from corporeal.model.surface_model import SurfaceModel
from corporeal.registration.options import RegistrationOptions
from corporeal.scans.units import BODY_EXTENT, HAND_EXTENT, HEAD_EXTENT, Extent


@dataclass(frozen=True)
class SubjectKind:
    """A kind of subject.

    Attributes:
        name: "hand", "body" or "head"; files of results are called after it.
        detector_sets: the model's landmark sets that the kind's detector fits, best first.
        given_set: the landmark set that a user's file names.
        extent: least and greatest diagonal of the bounding box of a scan, metres.
        options: makes the options of a lone scan.
        session_options: makes those of a session's scans.
    """

    name: str
    detector_sets: tuple[str, ...]
    given_set: str
    extent: Extent
    options: Callable[[], RegistrationOptions]
    session_options: Callable[[], RegistrationOptions]

    def detector_set(self, model: SurfaceModel) -> str | None:
        """The first of the sets that the model has, or None."""
        return next((name for name in self.detector_sets if name in model.landmarks), None)


HAND = SubjectKind(
    "hand",
    ("hand_21_detector", "hand_21_mediapipe"),
    "hand_21_mediapipe",
    HAND_EXTENT,
    RegistrationOptions,
    RegistrationOptions.for_sessions,
)
BODY = SubjectKind(
    "body",
    ("body_75_detector", "mediapipe_33"),
    "mediapipe_33",
    BODY_EXTENT,
    RegistrationOptions.for_bodies,
    RegistrationOptions.for_bodies,
)
HEAD = SubjectKind(
    "head",
    ("face_51_detector", "face"),
    "face_68_ibug",
    HEAD_EXTENT,
    RegistrationOptions.for_heads,
    RegistrationOptions.for_heads,
)
SUBJECTS = (HAND, BODY, HEAD)


def subject_of(model: SurfaceModel) -> SubjectKind:
    """The kind of a model: the first whose landmarks it has; a hand where it has none of any kind."""
    return next((kind for kind in SUBJECTS if kind.detector_set(model) is not None), HAND)
