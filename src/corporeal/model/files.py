"""Model files: ours and the official ones of the SMPL family, in; ours and theirs, out."""

from __future__ import annotations

import re
import warnings
from importlib import resources
from pathlib import Path
from typing import Literal

from corporeal.model.formats.archive import SIZE_LIMIT, write_archive
from corporeal.model.formats.containers import source_of, write_pickle
from corporeal.model.formats.core_arrays import Precision, core_keys
from corporeal.model.formats.errors import LeftHandWarning, ModelFileError, file_error
from corporeal.model.formats.families import family_of_tree
from corporeal.model.formats.fields import numbers
from corporeal.model.formats.left_hand import check_left_hand, repaired_left_hand
from corporeal.model.formats.native import is_native, native_keys, read_native
from corporeal.model.formats.official import read_official, statistics_keys
from corporeal.model.heads import head_of, with_face_marks
from corporeal.model.mirror import mirror_model
from corporeal.model.populations import Population, of_population
from corporeal.model.surface_model import Side, SurfaceModel

__all__ = [
    "LeftHandWarning",
    "ModelFileError",
    "check_left_hand",
    "load_model",
    "open_model",
    "save_model",
]

Layout = Literal["native", "official"]

_SEXES = ("female", "male")
_NAMES = '"hand", "body", "body_female", "body_male" and "head"'
_EXPECTED = "expected .npz or .pkl: a model of corporeal, MANO, SMPL, SMPL+H, SMPL-X or FLAME"
# Archives; pickles of protocol 2 and later; of protocols 0 and 1 what opens a tuple, dictionary or class.
_CONTAINER_START = re.compile(rb"PK|\x80|[(}\]]|c[\w.]+\r?\n[\w.]+\r?\n")


def load_model(
    path: Path | str, *, right: Path | str | SurfaceModel | None = None, repair_left: bool = False
) -> SurfaceModel:
    """Read a model: our own file, or an official one of MANO, SMPL, SMPL+H, SMPL-X or FLAME.

    Container (``.npz`` or pickle) and family are told from the content, never from the file's name. Pickles
    are read as plain data; nothing in them is run. Arrays come as float64 and int64.

    Args:
        path: the file.
        right: for a left hand, the right hand of the same model: tells whether the left one has the known
            fault of left-hand MANO files (the x component of its shape directions is not mirrored).
        repair_left: repair that fault where ``right`` shows it.

    Raises:
        ModelFileError: the file cannot be read or holds no model; the message says why and what to do.

    Warns:
        LeftHandWarning: an official left hand was given alone, or was found faulty and not repaired.
    """
    path = Path(path)
    model, official = _read(path)
    if right is not None:
        right_model = right if isinstance(right, SurfaceModel) else load_model(right)
        return _checked_left_hand(path, model, right_model, repair_left)
    if repair_left:
        advice = "give the right-hand file too, since a sound left hand would be spoiled"
        raise file_error(path, "cannot be repaired alone", advice)
    if official and model.side == "left":
        warnings.warn(
            f"{path}: in some left-hand MANO files the x component of the shape directions is not mirrored; "
            "give the right-hand file too to have this one checked",
            LeftHandWarning,
            stacklevel=2,
        )
    return model


def save_model(
    model: SurfaceModel, path: Path | str, *, layout: Layout = "native", precision: Precision = "float64"
) -> None:
    """Write a model; the ending decides between ``.npz`` and ``.pkl`` (for programs that only read pickles).

    Both layouts have the SMPL family's keys, with directions padded by zeros to the counts that smplx asks
    for (see ``formats.core_arrays``): smplx poses them to the same vertices. The native layout adds what the
    family has no keys for, under names that begin with ``corporeal_``, and gives back the same model bit by
    bit.
    The same model gives the same bytes. Files are written to a temporary name, then renamed.

    Args:
        model: what to write.
        path: where to; its folder is made where it is missing.
        layout: "native", or "official" for the family's keys alone.
        precision: in which shape, expression and pose directions are stored. float64 is exact; float32 rounds
            by 6e-8 and float16 by 5e-4 of each number (0.05 mm at a displacement of 10 cm).

    Raises:
        ModelFileError: the ending is another, the folder cannot be written, or the layout has no room.
    """
    path = Path(path)
    writers = {".npz": write_archive, ".pkl": write_pickle}
    if path.suffix not in writers:
        raise file_error(path, f"unknown ending {path.suffix!r}", "write to .npz or .pkl")
    if layout == "official" and family_of_tree(model.parents) is None:
        raise file_error(path, "the model's tree is of no official family", "use the native layout")
    try:
        arrays = core_keys(model, precision) | statistics_keys(model)
    except ValueError as error:
        raise file_error(path, str(error), "nothing was written") from error
    if layout == "native":
        arrays |= native_keys(model)
    try:
        writers[path.suffix](path, arrays)
    except OSError as error:
        raise file_error(path, f"cannot be written ({error.strerror})", "check the folder") from error


def open_model(name: str, side: Side = "right") -> SurfaceModel:
    """A model that comes with the package: "hand", "body", "body_female", "body_male", "head".

    A left hand is the mirrored right one. The sexes are the body about another mean, in the same shape space.
    The head is the body's.

    Raises:
        ModelFileError: there is no model of that name.
    """
    folder = resources.files("corporeal.model") / "open_models"
    base, _, sex = name.rpartition("_")
    with resources.as_file(folder) as place:
        if sex in _SEXES and (place / f"{base}_sexes.npz").is_file():
            source = source_of((place / f"{base}_sexes.npz").read_bytes())
            mean = numbers(source, f"{sex}_mean", (None,))
            directions = numbers(source, f"{sex}_directions", (len(mean), len(mean)))
            return of_population(load_model(place / f"{base}.npz"), Population(mean, directions), name)
        if name == "head":
            return head_of(with_face_marks(load_model(place / "body.npz"), place / "face_detector.npz"))
        path = place / f"{name}.npz"
        if not path.is_file():
            raise file_error(name, "no model of that name comes with corporeal", f"there are {_NAMES}")
        model = load_model(path)
    return model if model.side in (None, side) else mirror_model(model)


def _read(path: Path) -> tuple[SurfaceModel, bool]:
    """The model, and whether the file is an official one."""
    if path.is_dir():
        raise file_error(path, "is a folder", _EXPECTED)
    try:
        size = path.stat().st_size
        content = path.read_bytes() if size <= SIZE_LIMIT else b""
    except OSError as error:
        raise file_error(path, f"cannot be read ({error.strerror})", "check the path") from error
    if size > SIZE_LIMIT:
        raise file_error(path, f"{size} bytes are more than any model has", "give a model file")
    if not _CONTAINER_START.match(content):
        raise file_error(path, "holds no model", _EXPECTED)
    try:
        source = source_of(content)
        return (read_native(source), False) if is_native(source) else (read_official(source), True)
    except (
        Exception
    ) as error:  # Damaged bytes make the zip, npy, pickle and JSON parsers raise nearly anything.
        reason = (
            str(error) if isinstance(error, (ValueError, TypeError)) else f"{type(error).__name__}: {error}"
        )
        advice = (
            "give a model of corporeal, MANO, SMPL, SMPL+H, SMPL-X or FLAME, and obtain a damaged one again"
        )
        raise file_error(path, f"holds no model that can be read: {reason}", advice) from error


def _checked_left_hand(
    path: Path, left: SurfaceModel, right: SurfaceModel, repair_left: bool
) -> SurfaceModel:
    if left.side != "left" or right.side != "right":
        problem = f"compared as left and right hand, but the sides are {left.side} and {right.side}"
        raise file_error(path, problem, "give the left-hand file, and the right-hand one to compare with")
    verdict = check_left_hand(left, right)
    if verdict == "unrelated":
        raise file_error(path, "is no mirror image of the right hand", "give the two hands of one model")
    if verdict == "sound":
        return left
    if repair_left:
        return repaired_left_hand(left)
    warnings.warn(
        f"{path}: the x component of its shape directions is not mirrored; repair it with repair_left=True",
        LeftHandWarning,
        stacklevel=3,
    )
    return left
