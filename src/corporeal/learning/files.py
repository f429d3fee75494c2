"""What a model was learned with, on disk: personal templates, poses and the log, beside the model file."""

from __future__ import annotations

import dataclasses
import io
import json
from pathlib import Path
from typing import Any

import numpy as np

from corporeal.atomic import write_bytes
from corporeal.learning.learned import LearnedModel, StepLog
from corporeal.learning.options import LearningOptions
from corporeal.model.files import load_model, save_model

_WORDS = ("hands", "subjects", "names", "left_out")
_NUMBERS = ("templates", "joints", "poses", "translations", "rms_mm", "shape_variances", "pose_variances")


class LearnedFileError(ValueError):
    """A file is not what learning wrote; the message names it and says what to do."""


def companion_path(model_path: Path | str) -> Path:
    """Where templates, poses and log of a learned model lie: ``hand.npz`` -> ``hand.learning.npz``."""
    path = Path(model_path)
    return path.with_name(f"{path.stem}.learning.npz")


def save_learned(learned: LearnedModel, path: Path | str) -> None:
    """Write the model in float32 directions, and beside it what it was learned with.

    The companion is written first, so that a model file is never alone.

    Raises:
        ModelFileError, OSError: a file cannot be written.
    """
    arrays = {name: np.asarray(getattr(learned, name)) for name in _NUMBERS}
    arrays["templates"] = arrays["templates"].astype(np.float32)
    arrays |= {name: np.array(getattr(learned, name), dtype=np.str_) for name in _WORDS}
    arrays["log"] = np.array(json.dumps([dataclasses.asdict(step) for step in learned.log]))
    arrays["options"] = np.array(json.dumps(dataclasses.asdict(learned.options)))
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_bytes(companion_path(path), buffer.getvalue())
    save_model(learned.model, path, precision="float32")


def load_learned(path: Path | str) -> LearnedModel:
    """Read a learned model and its companion.

    Args:
        path: of the model file.

    Raises:
        ModelFileError: the model cannot be read.
        LearnedFileError: its companion is missing, damaged, or of another model.
    """
    model, companion = load_model(path), companion_path(path)
    try:
        with np.load(io.BytesIO(companion.read_bytes()), allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
        log = tuple(StepLog(**step) for step in json.loads(str(arrays["log"])))
        options = LearningOptions(**json.loads(str(arrays["options"])))
        kept: dict[str, Any] = {name: tuple(str(word) for word in arrays[name]) for name in _WORDS}
        kept |= {name: np.asarray(arrays[name], dtype=np.float64) for name in _NUMBERS}
    except FileNotFoundError as error:
        raise LearnedFileError(
            f"{companion}: missing; personal templates and poses stand there: learn the model again"
        ) from error
    except KeyError as error:
        raise LearnedFileError(
            f"{companion}: holds no {error}: written by an earlier version, or damaged; learn the model again"
        ) from error
    except Exception as error:  # Damaged bytes make the zip, npy and JSON parsers raise nearly anything.
        raise LearnedFileError(f"{companion}: damaged ({error}); learn the model again") from error
    if kept["templates"].shape[1:] != model.template.shape:
        raise LearnedFileError(f"{companion}: of another model than {path}; learn the model again")
    return LearnedModel(model=model, log=log, options=options, **kept)
