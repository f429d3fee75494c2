"""What commands read of a registered session: registrations, scans and their truth."""

from __future__ import annotations

import dataclasses
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from corporeal.cli.errors import CommandError
from corporeal.cli.named_models import named_model
from corporeal.cli.session_pictures import model_of, scan_of
from corporeal.learning.evaluation.held_out import HeldOut
from corporeal.learning.evaluation.pose_generalisation import HeldOutScan
from corporeal.learning.evaluation.simulated_truth import TrueScan, planned_scans
from corporeal.learning.training_set import LearningError, TrainingSet, training_set
from corporeal.model.files import ModelFileError
from corporeal.model.surface_model import SurfaceModel
from corporeal.registration.session.files import (
    MANIFEST,
    SessionFolderError,
    read_decisions,
    read_json_file,
    read_records,
)
from corporeal.registration.session.records import RecordError, SessionRecord
from corporeal.scans.files import ScanFileError
from corporeal.scans.formats.session import LIST
from corporeal.scans.scan import Scan
from corporeal.scans.segmentation import remove_object
from corporeal.scans.simulation.simulate import ScanTruth, SimulationOptions


@dataclass(frozen=True, eq=False)
class RegisteredSession:
    """A registered session.

    Attributes:
        folder: of its results.
        session: folder of its scans, or None where the manifest names none.
        simulation: how it was simulated, or None.
        green_objects: it was registered without points painted green.
        records: name -> record.
        registrations: the accepted ones of the model's side.
    """

    folder: Path
    session: Path | None
    simulation: SimulationOptions | None
    green_objects: bool
    records: Mapping[str, SessionRecord]
    registrations: TrainingSet


def read_registered(folder: Path, model: SurfaceModel) -> RegisteredSession:
    """Read a registered session for a model of one side.

    Raises:
        CommandError: it cannot be read, does not fit the model, or has no accepted registration of its side.
    """
    try:
        records = [record for record in read_records(folder) if record.side == model.side]
        registrations = training_set(records, model, read_decisions(folder))
    except (RecordError, SessionFolderError, LearningError) as error:
        raise CommandError(f"{folder}: {error}", 2) from error
    session, options = _manifest(folder)
    return RegisteredSession(
        folder=folder,
        session=session,
        simulation=simulation_of(session),
        green_objects=bool(options.get("green_objects")),
        records={record.name: record for record in records},
        registrations=registrations,
    )


def start_of(start: str | None, folder: Path) -> SurfaceModel:
    """The model that ``--start`` names, or where it is not given the one that a session was registered with.

    Raises:
        CommandError: it cannot be read.
    """
    if start is None:
        return model_of(folder)
    try:
        return named_model(Path(start))
    except (OSError, ModelFileError) as error:
        raise CommandError(f"--start {error}", 2) from error


def check_unseen(test: RegisteredSession, train: Sequence[Path], subjects: Iterable[str]) -> None:
    """Refuse a test session of people that the model was learned from.

    People of one name are the same where the sessions are: the same folder, or simulated from the same seed.

    Args:
        test: held-out session.
        train: folders of registrations that were learned from.
        subjects: that were learned from.

    Raises:
        CommandError: a test subject was learned from.
    """
    common = sorted(set(test.registrations.subjects) & set(subjects))
    if not common:
        return
    for folder in train:
        session, _ = _manifest(folder)
        seeds = {made.seed for made in (simulation_of(session), test.simulation) if made is not None}
        places = {place.resolve() for place in (session, test.session) if place is not None}
        simulated = simulation_of(session) is not None and test.simulation is not None
        same_place = session is not None and test.session is not None and len(places) == 1
        if (simulated and len(seeds) == 1) or same_place or folder.resolve() == test.folder.resolve():
            raise CommandError(
                f"--test {test.folder}: holds people that the model was learned from ({', '.join(common[:5])}"
                f" of {folder}); give a session of others, for instance simulated with another --seed",
                2,
            )


def scored_scans(test: RegisteredSession, chosen: HeldOut) -> list[HeldOutScan]:
    """Read the scans that are scored.

    Raises:
        CommandError: one cannot be read.
    """
    registrations = chosen.registrations
    return [
        HeldOutScan(
            registrations.names[index], registrations.subjects[index], registrations.hands[index],
            read_scan_of(test, registrations.names[index]), registrations.poses[index],
            registrations.vertices[index],
        )
        for index in chosen.scored
    ]  # fmt: skip


def read_scan_of(registered: RegisteredSession, name: str) -> Scan:
    """A scan of a registered session, without green objects where it was registered so.

    Raises:
        CommandError: it cannot be read.
    """
    try:
        scan = scan_of(registered.records[name], registered.session)
        return remove_object(scan) if registered.green_objects else scan
    except (ScanFileError, ValueError) as error:
        raise CommandError(f"{registered.folder}: the scan {name} is missing: {error}") from error


def true_scans(test: RegisteredSession, hands: Iterable[str]) -> list[TrueScan]:
    """The truth of the accepted scans of some hands; none where the session was not simulated.

    Raises:
        CommandError: a truth cannot be read.
    """
    if test.session is None or test.simulation is None or not (test.session / "truth").is_dir():
        return []
    planned, wanted, found = planned_scans(test.simulation), set(hands), []
    for name, hand in sorted(zip(test.registrations.names, test.registrations.hands, strict=True)):
        path = test.session / "truth" / f"{name}.npz"
        if hand in wanted and name in planned and path.exists():
            found.append(TrueScan(*planned[name], read_truth(path)))
    return found


def read_truth(path: Path) -> ScanTruth:
    """What ``corporeal simulate`` wrote of a scan.

    Raises:
        CommandError: it cannot be read.
    """
    try:
        with np.load(path, allow_pickle=False) as archive:
            return ScanTruth(
                template=archive["template"].astype(np.float64),
                joints=archive["joints"],
                angles=archive["angles"],
                fault=str(archive["fault"]),
                pose_share=float(archive["pose_share"]),
                volume_ratio=float(archive["volume_ratio"]),
                smallest_det=float(archive["smallest_det"]),
                deepest=float(archive["deepest"]),
            )
    except (OSError, ValueError, KeyError, zipfile.BadZipFile) as error:
        raise CommandError(f"{path}: not the truth of a scan: {error}", 2) from error


def _manifest(folder: Path) -> tuple[Path | None, Mapping[str, Any]]:
    """Folder of the scans, and the options of the registration."""
    try:
        manifest = read_json_file(folder / MANIFEST) or {}
    except SessionFolderError as error:
        raise CommandError(str(error), 2) from error
    named = manifest.get("session")
    path = named.get("path") if isinstance(named, dict) else named
    options = manifest.get("options")
    return Path(path) if path else None, options if isinstance(options, dict) else {}


def simulation_of(session: Path | None) -> SimulationOptions | None:
    """How a session was simulated; None where it was not."""
    if session is None:
        return None
    try:
        options = (read_json_file(session / LIST) or {}).get("options")
    except SessionFolderError as error:
        raise CommandError(str(error), 2) from error
    if not isinstance(options, dict) or not {"subjects", "seed"} <= set(options):
        return None
    known = {field.name for field in dataclasses.fields(SimulationOptions)}
    return SimulationOptions(**{name: value for name, value in options.items() if name in known})
