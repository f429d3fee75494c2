"""What can be wrong with a model file, as exceptions and warnings of its own."""

from __future__ import annotations

from pathlib import Path


class ModelFileError(ValueError):
    """A model file cannot be read or written; the message names the file and says what to do."""


class LeftHandWarning(UserWarning):
    """A left-hand MANO file has, or may have, shape directions whose x component was never mirrored."""


def file_error(path: Path | str, problem: str, advice: str) -> ModelFileError:
    """An error in one line (numpy's own have several): the file, what is wrong with it, what to do."""
    return ModelFileError(f"{path}: {' '.join(problem.split())}; {advice}")
