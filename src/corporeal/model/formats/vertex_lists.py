"""Files that list which vertices of a body are those of its hands, as MANO_SMPLX_vertex_ids.pkl does."""

from __future__ import annotations

import pickle
import zipfile
from pathlib import Path

import numpy as np
from jaxtyping import Int

from corporeal.model.formats.containers import source_of
from corporeal.model.formats.errors import file_error

_SIDES = ("left", "right")


def read_vertex_lists(path: Path | str) -> dict[str, Int[np.ndarray, " h"]]:
    """Side -> the body's index of every vertex of that hand model, from ``left_hand`` and ``right_hand``.

    Reads ``.npz`` and ``.pkl``; nothing in a pickle is executed.

    Raises:
        ModelFileError: the file cannot be read, or lacks one of the two lists.
    """
    try:
        source = source_of(Path(path).read_bytes())
        there = [side for side in _SIDES if f"{side}_hand" in source.names]
        lists = {side: np.asarray(source.value(f"{side}_hand")) for side in there}
    except OSError as error:
        raise file_error(path, str(error), "give a file with the vertices of both hands") from error
    except (pickle.UnpicklingError, zipfile.BadZipFile, ValueError, KeyError, EOFError) as error:
        raise file_error(path, f"not a list of vertices: {error}", "expected .npz or .pkl") from error
    for side in _SIDES:
        if side not in lists:
            raise file_error(path, f"holds no '{side}_hand'", "expected the lists left_hand and right_hand")
    for side, numbers in lists.items():
        if numbers.ndim != 1 or numbers.dtype.kind not in "iu":
            raise file_error(path, f"{side}_hand is not a list of whole numbers", "expected vertex indices")
    return {side: numbers.astype(np.int64) for side, numbers in lists.items()}
