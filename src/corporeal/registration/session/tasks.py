"""One scan of a session, from its file to its record: what every worker runs."""

from __future__ import annotations

import dataclasses
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numba
import numpy as np
import torch

from corporeal.model.mirror import mirror_model
from corporeal.model.surface_model import Side, SurfaceModel
from corporeal.registration.evidence import LandmarkEvidence, LandmarkFinder
from corporeal.registration.options import RegistrationOptions
from corporeal.registration.register import register
from corporeal.registration.registration import FailedRegistration, Registration
from corporeal.registration.rows import failed_row, registered_row
from corporeal.registration.session.files import sha256_of
from corporeal.registration.session.jobs import ScanJob, WorkerError
from corporeal.registration.session.records import FoundLandmarks, KnownLandmarks, SessionRecord
from corporeal.registration.subjects import subject_of
from corporeal.scans.files import ScanFileError, read_scan
from corporeal.scans.scan import Scan
from corporeal.scans.segmentation import remove_object
from corporeal.scans.units import UnitChoice

WriteOutputs = Callable[[Registration, dict[str, Any]], dict[str, str]]
"""Writes the files of one scan on request, told its row; returns label -> path."""


@dataclass(frozen=True, eq=False)
class RegistrationSetup:
    """How the scans of a session are registered; sent once to every worker.

    Attributes:
        model: of either side; the mirrored one is made once per worker.
        options: of every registration; the second round adds its pose prior.
        unit: of the scans' files.
        side: of all scans for which the session does not say it.
        green_objects: drop points painted green.
        write_outputs: what to write besides the record, or None; picklable.
    """

    model: SurfaceModel
    options: RegistrationOptions
    unit: UnitChoice = "auto"
    side: Side | None = None
    green_objects: bool = False
    write_outputs: WriteOutputs | None = None

    def start(self) -> ScanWorker:
        """A worker for this process."""
        return ScanWorker(self)


class ScanWorker:
    """Registers scans one after the other; detector and mirrored model are made once."""

    def __init__(self, setup: RegistrationSetup) -> None:
        self._setup = setup
        self._finder = LandmarkFinder(setup.model)
        self._models: dict[Side | None, SurfaceModel] = {setup.model.side: setup.model}

    def close(self) -> None:
        """Let go of the detector."""
        self._finder.__exit__()

    def __call__(self, job: ScanJob) -> SessionRecord:
        """Register one scan; a bad one gets a failed row.

        Raises:
            WorkerError: the files on request cannot be written.
        """
        # numba's number is each thread's own, and dask chooses the thread.
        numba.set_num_threads(1)
        torch.set_num_threads(1)
        begun = time.perf_counter()
        seconds = {"landmarks": 0.0, "fit": 0.0}
        # Before it is read: should it change between the two, a resumed session registers it again.
        sha256 = sha256_of(Path(job.path))
        record = SessionRecord({})
        try:
            record = self._registered(job, sha256, seconds)
        except (ScanFileError, ScanContentError, OSError) as error:
            record = SessionRecord(failed_row(job.path, str(error), seconds, []))
        except WorkerError:
            raise
        except Exception as error:
            # One scan must never cost the others; a fault of ours is reported as one, with its place.
            place = traceback.extract_tb(error.__traceback__)[-1]
            where = f"{Path(place.filename).name}:{place.lineno}"
            reason = f"internal error, please report it: {error!r} in {where}"
            record = SessionRecord(failed_row(job.path, reason, seconds, []))
        record.row["seconds"]["total"] = time.perf_counter() - begun
        return dataclasses.replace(record, row=job.completed(record.row, sha256))

    def _registered(self, job: ScanJob, sha256: str | None, seconds: dict[str, float]) -> SessionRecord:
        setup = self._setup
        extent = subject_of(setup.model).extent
        scan = read_scan(job.path, unit=setup.unit, expected_extent=extent)
        if setup.green_objects:
            try:
                scan = remove_object(scan)
            except ValueError as error:
                raise ScanContentError(str(error)) from error
        marked = time.perf_counter()
        evidence, notes, found = self._evidence(job.landmarks, sha256, scan)
        seconds["landmarks"] = time.perf_counter() - marked
        marked = time.perf_counter()
        side = job.side or setup.side
        options = dataclasses.replace(setup.options, pose_prior=job.prior)
        result = register(scan, self._model(side), evidence, side, options)
        seconds["fit"] = time.perf_counter() - marked
        if isinstance(result, FailedRegistration):
            return SessionRecord(failed_row(job.path, result.reason, seconds, notes), landmarks=found)
        record = self._record(job, result, registered_row(job.path, result, seconds, notes))
        return dataclasses.replace(record, landmarks=found)

    def _evidence(
        self, known: KnownLandmarks | None, sha256: str | None, scan: Scan
    ) -> tuple[LandmarkEvidence | None, list[str], FoundLandmarks | None]:
        """Landmarks found before where they still hold, else those of the detector."""
        unused = []
        if known is not None:
            reason = self._why_not(known, sha256)
            if reason is None:
                return _evidence_of(known.found), [f"landmarks of {known.origin}"], known.found
            unused = [f"landmarks of {known.origin} not used: {reason}"]
        detected, notes = self._finder.find(scan)
        notes = unused + notes
        if detected is None:
            return None, notes, None
        names = tuple(detected.positions)
        found = FoundLandmarks(
            detected.set_name,
            names,
            np.array([detected.positions[name] for name in names]),
            np.array([detected.sigmas.get(name, 1.0) for name in names]),
            float(detected.right_probability),
        )
        return detected, notes, found

    def _why_not(self, known: KnownLandmarks, sha256: str | None) -> str | None:
        """Why landmarks that were found before do not hold now, or None."""
        if known.sha256 != sha256:
            return "the scan has changed since they were found"
        if known.found.set_name != self._finder.set_name:
            return f"they were found for {known.found.set_name!r}, which this model does not use"
        return None

    def _model(self, side: Side | None) -> SurfaceModel:
        model = self._setup.model
        if side is None or model.side is None:
            return model
        if side not in self._models:
            self._models[side] = mirror_model(model)
        return self._models[side]

    def _record(self, job: ScanJob, result: Registration, row: dict[str, Any]) -> SessionRecord:
        if self._setup.write_outputs is not None:
            try:
                row["outputs"] = self._setup.write_outputs(result, row | {"name": job.name})
            except OSError as error:
                raise WorkerError(f"{job.name}: its files cannot be written: {error}") from error
        if not np.isfinite(result.vertices).all():
            return SessionRecord(row)
        parameters = result.parameters
        return SessionRecord(
            row, result.vertices, parameters.pose, parameters.shape, parameters.translation, result.side
        )


class ScanContentError(ValueError):
    """A scan that was read but does not allow what was asked."""


def _evidence_of(found: FoundLandmarks) -> LandmarkEvidence:
    positions = dict(zip(found.names, found.positions, strict=True))
    sigmas = dict(zip(found.names, found.sigmas.tolist(), strict=True))
    return LandmarkEvidence(positions, sigmas, found.right_probability, found.set_name)
