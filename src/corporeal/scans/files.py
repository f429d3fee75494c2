"""Reads a capture from disk into a checked and cleaned ``Scan``."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from urllib.parse import unquote

import numpy as np
from jaxtyping import Float

from corporeal.scans.cleaning import clean, drop_wild
from corporeal.scans.formats.gltf import buffers_of_json, parse_glb, parse_gltf
from corporeal.scans.formats.obj import parse_obj
from corporeal.scans.formats.off import parse_off
from corporeal.scans.formats.ply import parse_ply
from corporeal.scans.formats.sequence import ScanSequence, SequenceFileError
from corporeal.scans.formats.sequence import read_sequence as _listed_or_found
from corporeal.scans.formats.stl import parse_stl
from corporeal.scans.raw import RawScan
from corporeal.scans.scan import Scan
from corporeal.scans.units import HAND_EXTENT, Extent, UnitChoice, UnitError, resolve_unit

_PARSERS: dict[str, Callable[[bytes], RawScan]] = {
    ".ply": parse_ply,
    ".obj": parse_obj,
    ".stl": parse_stl,
    ".off": parse_off,
    ".coff": parse_off,
    ".glb": parse_glb,
}

SCAN_SUFFIXES = (*_PARSERS, ".gltf")
"""File names that ``read_scan`` knows, in lower case."""


class ScanFileError(ValueError):
    """A file is no scan; the message names it and says what was expected and what to do."""


def read_scan(path: str | Path, unit: UnitChoice = "auto", expected_extent: Extent = HAND_EXTENT) -> Scan:
    """Read a mesh or a point cloud, mend it, find its unit, and scale it to metres.

    The scan stays in its own frame. What was mended and guessed stands in ``Scan.repairs``. Nothing in the
    file is run, and no count in it is believed before it is compared with the file's length.

    Args:
        path: PLY, OBJ, STL, OFF (COFF), GLB or glTF; the suffix decides.
        unit: of the file's numbers; "auto" tells m, cm or mm from the size, "free" says that the file has no
            unit: the scale is then a provisional one, to be replaced by that of a fit (``Scan.with_scale``).
        expected_extent: least and greatest diagonal of the subject's bounding box, metres.

    Raises:
        ScanFileError: the file is missing, of another format, damaged or empty, or its unit cannot be told.
    """
    path = Path(path)
    raw = _parsed(path)
    try:
        cleaned = clean(raw)
        found, sentences = resolve_unit(cleaned.points, unit, expected_extent)
    except UnitError as error:
        raise ScanFileError(f"{path.name}: {error}") from error
    except ValueError as error:
        raise ScanFileError(f"{path.name}: nothing usable is left after cleaning: {error}") from error
    normals = np.zeros_like(cleaned.points) if cleaned.normals is None else cleaned.normals
    return Scan(
        name=path.stem,
        points=cleaned.points * found.metres_per_unit,
        faces=cleaned.faces,
        normals=normals,
        colours=cleaned.colours,
        unit=found,
        source=path.name,
        repairs=(*cleaned.notes, *sentences),
    )


def read_scan_points(
    path: str | Path, unit: UnitChoice = "auto", expected_extent: Extent = HAND_EXTENT
) -> Float[np.ndarray, "N 3"]:
    """The points of a scan in metres, to be looked at: about twenty times as fast as ``read_scan``.

    Nothing is mended but that points which are not finite, or wildly far away, are left out.

    Args:
        path: as for ``read_scan``.
        unit: of the file's numbers.
        expected_extent: least and greatest diagonal of the subject's bounding box, metres.

    Raises:
        ScanFileError: the file is missing, of another format, damaged or empty, or its unit cannot be told.
    """
    path = Path(path)
    raw = _parsed(path)
    try:
        points = drop_wild(raw).points
        return points * resolve_unit(points, unit, expected_extent)[0].metres_per_unit
    except ValueError as error:
        raise ScanFileError(f"{path.name}: {error}") from error


def read_sequence(folder: str | Path) -> ScanSequence:
    """Read which scans a folder holds one after the other: its ``sequence.json``, or all of its scan files.

    The scans themselves are not opened: a frame that is missing or damaged costs no other.

    Raises:
        ScanFileError: the list cannot be read or breaks its format, or there is no scan at all.
    """
    try:
        return _listed_or_found(Path(folder), SCAN_SUFFIXES)
    except SequenceFileError as error:
        raise ScanFileError(str(error)) from error


def _parsed(path: Path) -> RawScan:
    suffix = path.suffix.lower()
    if suffix not in SCAN_SUFFIXES:
        raise ScanFileError(f"{path.name}: expected a file that ends in {', '.join(SCAN_SUFFIXES)}")
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ScanFileError(f"{path}: cannot be read: {error.strerror or error}") from error
    if not data:
        raise ScanFileError(f"{path.name}: the file is empty")
    kind = suffix[1:].upper()
    try:
        if suffix == ".gltf":
            return parse_gltf(data, {uri: _beside(path, uri) for uri in buffers_of_json(data)})
        return _PARSERS[suffix](data)
    except (ValueError, OSError) as error:
        raise ScanFileError(f"{path.name}: cannot be read as {kind}: {error}") from error
    except Exception as error:
        # A damaged file can make the parsers of glTF fail in any way; all of them mean the same to the user.
        trouble = f"{type(error).__name__}: {str(error)[:80]}"
        raise ScanFileError(
            f"{path.name}: damaged, or no {kind} at all ({trouble}); save it again"
        ) from error


def _beside(path: Path, uri: str) -> bytes:
    """A file that a glTF names, from its own folder only: a scan must not make us read elsewhere."""
    folder = path.parent.resolve()
    target = (folder / unquote(uri)).resolve()
    if not target.is_relative_to(folder):
        raise ValueError(f"its buffer {uri!r} lies outside of its folder")
    return target.read_bytes()
