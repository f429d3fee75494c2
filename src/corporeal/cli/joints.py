"""``corporeal joints``: a start model's joints, placed by the scans of a registered session."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from jaxtyping import Int
from rich.console import Console

import corporeal
from corporeal.cli.commands import Joints
from corporeal.cli.errors import CommandError
from corporeal.cli.files import check_output_folder, check_result, write_result
from corporeal.cli.registered_session import RegisteredSession, read_registered, read_scan_of, start_of
from corporeal.fitting.joint_places import JointPlaceError, PlacedJoints, PosedScan, place_joints
from corporeal.learning.training_set import TrainingSet
from corporeal.model.files import ModelFileError, save_model
from corporeal.model.surface_model import SurfaceModel
from corporeal.scans.surface_sampling import sample_surface

# Points of a scan that are looked at, evenly spread.
_POINTS = 2500


def run(config: Joints) -> int:
    """Place the joints and write the model; 0 when it is written."""
    _check_call(config)
    console = Console(stderr=True, markup=False, highlight=False, soft_wrap=True)
    begun = time.monotonic()
    start = start_of(config.start, config.registrations)
    session = read_registered(config.registrations, start)
    chosen = evenly_bent(session.registrations, config.scans)
    hands = len(set(chosen.hands))
    console.print(f"{len(chosen)} scans of {hands} hands")
    try:
        placed = place_joints(
            start, read_posed(session, chosen), on_step=lambda step, rms: console.print(
                f"step {step}: {rms:.3f} mm"
            ),
        )  # fmt: skip
    except JointPlaceError as error:
        raise CommandError(f"{config.registrations}: {error}") from error
    model = placed.model.replace(name=config.name or start.name, notes=_notes(start, len(chosen), hands))
    try:
        save_model(model, config.output, precision=config.precision)
    except (OSError, ModelFileError) as error:
        raise CommandError(f"{config.output}: cannot be written: {error}") from error
    moved = 1e3 * np.linalg.norm(placed.shifts, axis=1)
    furthest = int(moved.argmax())
    console.print(
        f"{config.output}: joints moved by {moved[1:].mean():.1f} mm in the mean, "
        f"{model.joint_names[furthest]} by {moved[furthest]:.1f}; {time.monotonic() - begun:.0f} s"
    )
    if config.json is not None:
        write_result(config.json, _result(placed, model, chosen, time.monotonic() - begun))
    return 0


def evenly_bent(registrations: TrainingSet, count: int) -> TrainingSet:
    """So many registrations of every hand, evenly from the most bent to the least."""
    bends = np.abs(registrations.poses[:, 1:]).sum(axis=(1, 2))
    hands = np.array(registrations.hands)
    return registrations.subset(
        np.concatenate([_evenly(np.flatnonzero(hands == hand), bends, count) for hand in sorted(set(hands))])
    )


def read_posed(session: RegisteredSession, chosen: TrainingSet) -> list[PosedScan]:
    """The scans of registrations, with the poses that these start from.

    Raises:
        CommandError: a scan cannot be read.
    """
    scans = []
    for index, name in enumerate(chosen.names):
        points, _ = sample_surface(read_scan_of(session, name), _POINTS)
        scans.append(
            PosedScan(
                name, chosen.hands[index], points, chosen.poses[index], chosen.shapes[index],
                chosen.translations[index],
            )
        )  # fmt: skip
    return scans


def _evenly(indices: Int[np.ndarray, " n"], bends: np.ndarray, count: int) -> Int[np.ndarray, " m"]:
    ordered = indices[np.argsort(-bends[indices], kind="stable")]
    return ordered[np.unique(np.linspace(0, len(ordered) - 1, count).astype(int))]


def _notes(start: SurfaceModel, scans: int, hands: int) -> dict[str, Any]:
    words = f"corporeal {corporeal.__version__} joints, from {scans} scans of {hands} hands"
    return dict(start.notes) | {"joints": words}


def _result(placed: PlacedJoints, model: SurfaceModel, chosen: TrainingSet, seconds: float) -> dict[str, Any]:
    moved = zip(model.joint_names, (1e3 * placed.shifts).tolist(), strict=True)
    return {
        "scans": list(chosen.names), "rms_mm": list(placed.rms_mm), "shifts_mm": dict(moved),
        "seconds": seconds,
    }  # fmt: skip


def _check_call(config: Joints) -> None:
    if config.output.suffix != ".npz":
        raise CommandError(f"-o {config.output}: name a file that ends in .npz", 2)
    if config.scans < 1:
        raise CommandError(f"--scans {config.scans}: at least one is needed", 2)
    check_output_folder(config.output.parent)
    if config.json is not None:
        check_result(config.json)
