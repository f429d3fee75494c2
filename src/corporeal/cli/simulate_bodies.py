"""``corporeal simulate --body``: sequences of people in motion with the truth beside every frame."""

from __future__ import annotations

import dataclasses
import io
import time
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

import corporeal
from corporeal.atomic import write_bytes
from corporeal.cli.commands import Simulate
from corporeal.cli.errors import CommandError
from corporeal.cli.files import check_result, write_json, write_result
from corporeal.cli.simulation_pool import check_same, make_pieces
from corporeal.export.meshes import write_ply
from corporeal.scans.formats.sequence import FORMAT, LIST
from corporeal.scans.simulation.bodies.motion import FPS
from corporeal.scans.simulation.bodies.sequences import (
    FrameTruth,
    PlannedSequence,
    SequenceOptions,
    SequenceSimulator,
    plan_sequences,
)

_PIECE = 10
_HANDS_ONLY = ("poses", "sides", "objects", "bad_one_in", "natural_share")
_DEFAULT = SequenceOptions()


def run(config: Simulate) -> int:
    """Make what is missing of all sequences."""
    options = _options(config)
    plan = plan_sequences(options)
    for planned in plan:
        _write_list(config.output / planned.name, options, planned)
    missing = [
        (planned, frame)
        for planned in plan
        for frame in range(planned.frames)
        if not _truth_file(config.output / planned.name, frame).exists()
    ]
    console = Console(stderr=True)
    total = len(plan) * options.frames
    if len(missing) < total:
        console.print(f"{total - len(missing)} of {total} frames are there already", soft_wrap=True)
    begun = time.perf_counter()
    make_pieces(partial(make_frames, config.output), _pieces(missing), len(missing), config.workers, console)
    seconds = time.perf_counter() - begun
    if missing:
        console.print(
            f"{len(missing)} frames in {seconds:.0f} s, {seconds / len(missing):.2f} s each; {config.output}",
            soft_wrap=True,
            highlight=False,
        )
    if config.json is not None:
        result = {"sequences": [planned.name for planned in plan], "frames": total, "made": len(missing)}
        write_result(config.json, {**result, "seconds": seconds})
    return 0


def _options(config: Simulate) -> SequenceOptions:
    default = Simulate(config.output)
    for name in _HANDS_ONLY:
        if getattr(config, name) != getattr(default, name):
            raise CommandError(f"--{name.replace('_', '-')}: is for sessions of hands, not for --body", 2)
    sequences = _DEFAULT.sequences if config.sequences is None else config.sequences
    frames = _DEFAULT.frames if config.frames is None else config.frames
    for name, value in (("sequences", sequences), ("frames", frames), ("subjects", config.subjects)):
        if value is not None and value < 1:
            raise CommandError(f"--{name}: expected at least 1, got {value}", 2)
    if config.workers < 0 or config.seed < 0:
        raise CommandError("--workers and --seed: expected 0 or more", 2)
    if config.json is not None:
        check_result(config.json)
    return SequenceOptions(sequences, frames, config.subjects, config.seed)


def _pieces(missing: list[tuple[PlannedSequence, int]]) -> list[tuple[PlannedSequence, list[int]]]:
    """A few frames of one sequence at a time, so that the bar moves and workers end together."""
    frames: dict[PlannedSequence, list[int]] = {}
    for planned, frame in missing:
        frames.setdefault(planned, []).append(frame)
    return [
        (planned, numbers[i : i + _PIECE])
        for planned, numbers in frames.items()
        for i in range(0, len(numbers), _PIECE)
    ]


def make_frames(folder: Path, piece: tuple[PlannedSequence, list[int]]) -> int:
    """Make frames and write each with its truth; the truth comes last and says that the frame is whole."""
    planned, frames = piece
    for number in frames:
        made = _simulator(planned).frame(number)
        path = folder / planned.name / "scans" / f"{number:04d}.ply"
        write_ply(path, made.points_mm.astype(np.float32), made.faces, colours=made.colours)
        _write_truth(_truth_file(folder / planned.name, number), made.truth)
    return len(frames)


@lru_cache(maxsize=1)
def _simulator(planned: PlannedSequence) -> SequenceSimulator:
    return SequenceSimulator(planned)


def _write_truth(path: Path, truth: FrameTruth) -> None:
    arrays = {name: np.asarray(value) for name, value in dataclasses.asdict(truth).items()}
    arrays["template"] = arrays["template"].astype(np.float32)
    arrays["missing"] = np.array(truth.missing, dtype=np.str_)
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    write_bytes(path, buffer.getvalue())


def _truth_file(folder: Path, frame: int) -> Path:
    return folder / "truth" / f"{frame:04d}.npz"


def _write_list(folder: Path, options: SequenceOptions, planned: PlannedSequence) -> None:
    # More sequences may be added to a capture later: they change none that is there.
    begun_with = {"frames": options.frames, "seed": options.seed}
    content: dict[str, Any] = {
        "format": FORMAT,
        "name": planned.name,
        "subject": f"s{planned.subject + 1:02d}",
        "fps": FPS,
        "unit": "mm",
        "made_by": f"corporeal {corporeal.__version__} simulate --body",
        "options": begun_with,
        "frames": [{"name": f"{k:04d}", "file": f"scans/{k:04d}.ply"} for k in range(planned.frames)],
    }
    try:
        check_same(folder / LIST, begun_with, {})
        write_json(folder / LIST, content)
        for part in ("scans", "truth"):
            (folder / part).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CommandError(f"{folder}: cannot be written: {error.strerror or error}", 2) from error
