"""Registrations on disk: one .npz in metres, without pickles."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from corporeal.atomic import write_bytes
from corporeal.registration.registration import Registration


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
