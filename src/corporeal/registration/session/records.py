"""The compact record of one scan of a session: its row, and the quantised registration."""

from __future__ import annotations

import io
import json
import math
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

_STEP = 1e-5
"""Vertices are kept to half of this, metres: a fortieth of the noise of a scan."""
_DATE = (1980, 1, 1, 0, 0, 0)
_KEYS = ("origin", "pose", "row", "shape", "side", "step", "translation", "vertices")


class RecordError(ValueError):
    """A record cannot be read; the message names it and says what to do."""


@dataclass(frozen=True, eq=False)
class FoundLandmarks:
    """What the detector found in a scan, kept because it takes as long as a fit.

    Attributes:
        set_name: which of the model's landmark sets the names belong to.
        names: of the landmarks.
        positions: (N, 3) metres, in the scan's frame.
        sigmas: (N,) standard deviations relative to one another.
        right_probability: how likely it is a right hand.
    """

    set_name: str
    names: tuple[str, ...]
    positions: Float[np.ndarray, "N 3"]
    sigmas: Float[np.ndarray, " N"]
    right_probability: float


@dataclass(frozen=True, eq=False)
class KnownLandmarks:
    """Landmarks that were found in a scan before, for as long as its file has not changed.

    Attributes:
        found: by the detector.
        sha256: of the file that they were found in.
        origin: when they were found, as the row's note says it.
    """

    found: FoundLandmarks
    sha256: str
    origin: str


@dataclass(frozen=True, eq=False)
class SessionRecord:
    """What is kept of one scan. A scan that could not be registered has a row only.

    Attributes:
        row: the machine-readable item; ``row["seconds"]`` is all in it that differs from run to run.
        vertices: (V, 3) the registration in the scan's frame, metres; or None.
        pose: (K, 3) axis-angle, radians; or None.
        shape: (S,) shape coefficients, or None.
        translation: (3,) metres, or None.
        side: of the model that was fitted; None for a model without a side, or without a registration.
        landmarks: what the detector found, or None.
    """

    row: dict[str, Any]
    vertices: Float[np.ndarray, "V 3"] | None = None
    pose: Float[np.ndarray, "K 3"] | None = None
    shape: Float[np.ndarray, " S"] | None = None
    translation: Float[np.ndarray, "3"] | None = None
    side: Literal["left", "right"] | None = None
    landmarks: FoundLandmarks | None = None

    @property
    def name(self) -> str:
        """The scan's name in its session."""
        return str(self.row["name"])

    def known_landmarks(self, origin: str) -> KnownLandmarks | None:
        """The record's landmarks for another registration of its scan; None where it has none."""
        sha256 = self.row.get("sha256")
        if self.landmarks is None or sha256 is None:
            return None
        return KnownLandmarks(self.landmarks, str(sha256), origin)

    @property
    def is_registered(self) -> bool:
        """Whether there are vertices; a status of "failed" may still have them."""
        return self.vertices is not None


def encode_record(record: SessionRecord) -> bytes:
    """A record as an ``.npz`` of about 20 kB; the same record gives the same bytes.

    Vertices are rounded to steps of 10 micrometres from their least coordinates: 16 bits where they fit (up
    to 0.65 m), else 32. Pose and shape are rounded to float32. Numbers of the row that are not finite become
    null.
    """
    row = json.dumps(finite(record.row), sort_keys=True, allow_nan=False).encode()
    arrays = {"row": np.frombuffer(row, np.uint8)}
    if record.vertices is not None:
        if record.pose is None or record.shape is None or record.translation is None:
            raise ValueError(f"record {record.name!r}: vertices come with pose, shape and translation")
        origin = record.vertices.min(axis=0).astype(np.float64)
        counts = np.rint((record.vertices - origin) / _STEP)
        small = counts.max(initial=0) <= np.iinfo(np.uint16).max
        arrays |= {
            "origin": origin,
            "step": np.array(_STEP),
            "vertices": counts.astype(np.uint16 if small else np.uint32),
            "pose": record.pose.astype(np.float32),
            "shape": record.shape.astype(np.float32),
            "translation": record.translation.astype(np.float64),
            "side": np.array(record.side or ""),
        }
    if record.landmarks is not None:
        found = record.landmarks
        arrays |= {
            "landmark_set": np.array(found.set_name),
            "landmark_names": np.array(found.names, dtype=np.str_),
            "landmarks": found.positions,
            "landmark_sigmas": found.sigmas,
            "right_probability": np.array(found.right_probability),
        }
    return zipped(arrays)


def decode_record(content: bytes, source: str) -> SessionRecord:
    """The record in the bytes of a file.

    Args:
        content: of the whole file.
        source: what to call it in an error.

    Raises:
        RecordError: the bytes are cut off, changed (every array carries a checksum), or no record.
    """
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as archive:
            # Reading an array checks its CRC; all of them are read, so that damage shows here and not later.
            arrays = {name: archive[name] for name in archive.files}
        return _of_arrays(arrays)
    except Exception as error:  # Damaged bytes make the zip, npy and JSON parsers raise nearly anything.
        trouble = f"{type(error).__name__}: {str(error)[:80]}"
        advice = "register its session again: records that cannot be read are made anew"
        raise RecordError(
            f"{source}: damaged, or no record of a registration ({trouble}); {advice}"
        ) from error


def _of_arrays(arrays: Mapping[str, np.ndarray]) -> SessionRecord:
    row = json.loads(arrays["row"].tobytes())
    if not isinstance(row, dict) or not {"name", "status", "scan"} <= set(row):
        raise ValueError("its row has no name, status and scan")
    landmarks = None
    if "landmarks" in arrays:
        landmarks = FoundLandmarks(
            str(arrays["landmark_set"]),
            tuple(str(name) for name in arrays["landmark_names"]),
            arrays["landmarks"],
            arrays["landmark_sigmas"],
            float(arrays["right_probability"]),
        )
    if "vertices" not in arrays:
        return SessionRecord(row, landmarks=landmarks)
    missing = sorted(set(_KEYS) - set(arrays))
    if missing:
        raise ValueError(f"{missing[0]!r} is missing")
    side = str(arrays["side"])
    if side not in ("left", "right", ""):
        raise ValueError(f"unknown side {side!r}")
    return SessionRecord(
        row=row,
        vertices=arrays["origin"] + arrays["step"] * arrays["vertices"].astype(np.float64),
        pose=arrays["pose"],
        shape=arrays["shape"],
        translation=arrays["translation"],
        side=side or None,  # type: ignore[arg-type]
        landmarks=landmarks,
    )


def finite(value: Any) -> Any:
    """The same with null for numbers that are not finite, which JSON cannot say."""
    if isinstance(value, Mapping):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def zipped(arrays: Mapping[str, np.ndarray]) -> bytes:
    """``np.savez`` stamps the time on every entry; the same arrays must give the same bytes."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in sorted(arrays):
            entry = io.BytesIO()
            np.lib.format.write_array(entry, arrays[name], allow_pickle=False)
            info = zipfile.ZipInfo(f"{name}.npy", _DATE)
            info.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(info, entry.getvalue())
    return buffer.getvalue()
