"""Registrations on disk: one .npz in metres, without pickles."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

import numpy as np
from jaxtyping import Float, Int

from corporeal.atomic import write_bytes
from corporeal.model.surface_model import Side
from corporeal.registration.registration import Registration, Status
from corporeal.scans.scan import Unit, UnitName
from corporeal.terms.model_fields import ModelParameters


class RegistrationFileError(ValueError):
    """A file holds no registration; the message names it and says what is wrong."""


@dataclass(frozen=True, eq=False)
class SavedRegistration:
    """What ``registration.npz`` holds: metres and radians, in the scan's frame.

    Attributes:
        vertices: (V, 3) the registration.
        model_vertices: (V, 3) the fitted model alone.
        faces: (F, 3) of both.
        parameters: the fitted pose, shape and translation.
        side: of the model; None where it has none.
        landmarks: name -> (3,) position on the fitted model.
        model: its name.
        correctives: whether pose correctives were used.
        status: "ok", "doubtful" or "failed"; ``reason`` says why.
        unit: of the scan's file.
    """

    vertices: Float[np.ndarray, "V 3"]
    model_vertices: Float[np.ndarray, "V 3"]
    faces: Int[np.ndarray, "F 3"]
    parameters: ModelParameters
    side: Side | None
    landmarks: dict[str, np.ndarray]
    model: str
    correctives: bool
    status: Status
    reason: str
    unit: Unit


def save_registration(registration: Registration, path: Path) -> None:
    """Write vertices, parameters and landmarks of a registration.

    Keys: ``vertices`` and ``model_vertices`` (V, 3), ``faces`` (F, 3), ``pose`` (K, 3) axis-angle, ``shape``,
    ``translation`` (3,), ``side``, ``landmark_names`` and ``landmarks`` (N, 3), ``model``, ``correctives``,
    ``status``, ``reason``, ``unit`` and ``metres_per_unit`` of the scan's file. Metres and radians, in the
    scan's frame.
    """
    parameters, unit = registration.parameters, registration.scan.unit
    buffer = io.BytesIO()
    np.savez_compressed(
        buffer,
        vertices=registration.vertices,
        model_vertices=registration.model_vertices,
        faces=registration.model.faces,
        pose=parameters.pose,
        shape=parameters.shape,
        translation=parameters.translation,
        side=np.array(registration.side or ""),
        landmark_names=np.array(list(registration.landmarks)),
        landmarks=np.array(list(registration.landmarks.values())).reshape(-1, 3),
        model=np.array(registration.model.name),
        correctives=np.array(registration.correctives),
        status=np.array(registration.status),
        reason=np.array(registration.reason),
        unit=np.array(unit.name),
        metres_per_unit=np.array(unit.metres_per_unit),
    )
    write_bytes(path, buffer.getvalue())


def load_registration(path: Path) -> SavedRegistration:
    """Read what ``save_registration`` wrote.

    Raises:
        RegistrationFileError: not an archive, an array is missing or has the wrong shape, or the status, side
            or unit is not a known one.
        OSError: the file cannot be opened.
    """
    content = io.BytesIO(path.read_bytes())
    try:
        with np.load(content, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
        return _of_arrays(arrays)
    except Exception as error:  # Damaged bytes make the zip and npy parsers raise nearly anything.
        trouble = f"is missing {error}" if isinstance(error, KeyError) else str(error)[:120]
        raise RegistrationFileError(
            f"{path.name}: expected a registration.npz of corporeal register; {trouble}"
        ) from error


def _of_arrays(arrays: dict[str, np.ndarray]) -> SavedRegistration:
    vertices, faces = arrays["vertices"], arrays["faces"]
    names, positions = arrays["landmark_names"], arrays["landmarks"]
    shapes = {"vertices": (-1, 3), "model_vertices": vertices.shape, "faces": (-1, 3), "pose": (-1, 3),
              "translation": (3,), "landmarks": (len(names), 3)}  # fmt: skip
    for name, expected in shapes.items():
        found = arrays[name].shape
        if len(found) != len(expected) or any(b not in (a, -1) for a, b in zip(found, expected, strict=True)):
            raise ValueError(f"{name}: expected the shape {expected}, got {found}")
    if len(faces) and not 0 <= faces.min() <= faces.max() < len(vertices):
        raise ValueError(f"faces: expected indices from 0 to {len(vertices) - 1}")
    status, side, unit = (str(arrays[name]) for name in ("status", "side", "unit"))
    if status not in get_args(Status) or side not in ("", "left", "right") or unit not in get_args(UnitName):
        raise ValueError(f"unknown status, side or unit: {status!r}, {side!r}, {unit!r}")
    return SavedRegistration(
        vertices=vertices,
        model_vertices=arrays["model_vertices"],
        faces=faces,
        parameters=ModelParameters(arrays["translation"], arrays["pose"], arrays["shape"]),
        side=side or None,  # type: ignore[arg-type]
        landmarks={str(name): point for name, point in zip(names, positions, strict=True)},
        model=str(arrays["model"]),
        correctives=bool(arrays["correctives"]),
        status=status,  # type: ignore[arg-type]
        reason=str(arrays["reason"]),
        unit=Unit(unit, float(arrays["metres_per_unit"])),  # type: ignore[arg-type]
    )
