"""The ``.npz`` container: arrays in and out, with no pickles run and no size believed."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.lib import format as npy

from corporeal.atomic import write_bytes

# Four times the largest official file (SMPL-X in float64 with 400 directions).
SIZE_LIMIT = 2**30
_FIXED_TIME = (1980, 1, 1, 0, 0, 0)
# A full SMPL-X takes 5 s at level 4 and 19 s at level 6, for 5 % less.
_COMPRESSION = 4


def write_archive(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Write arrays as a compressed ``.npz``; the same arrays give the same bytes (no times in it)."""
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        for key in sorted(arrays):
            entry = zipfile.ZipInfo(f"{key}.npy", date_time=_FIXED_TIME)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = 0o644 << 16
            entry.create_system = 3
            payload = io.BytesIO()
            # C order whatever the array's own: equal content, equal bytes.
            npy.write_array(payload, np.array(arrays[key], order="C"), allow_pickle=False)
            archive.writestr(entry, payload.getvalue(), compresslevel=_COMPRESSION)
    write_bytes(path, content.getvalue())


class Archive:
    """The members of an ``.npz`` as raw bytes, read one by one when asked for.

    Raises:
        ValueError: the members together claim more than ``SIZE_LIMIT`` bytes.
        zipfile.BadZipFile: the file is no archive.
    """

    def __init__(self, content: bytes) -> None:
        self._zip = zipfile.ZipFile(io.BytesIO(content))
        claimed = sum(entry.file_size for entry in self._zip.infolist())
        if claimed > SIZE_LIMIT:
            raise ValueError(f"its members claim {claimed} bytes, more than the limit of {SIZE_LIMIT}")
        self._names = {name.removesuffix(".npy"): name for name in self._zip.namelist()}

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the members without their ending."""
        return tuple(self._names)

    def member(self, key: str) -> bytes:
        """The content of one member; its checksum is verified."""
        return self._zip.read(self._names[key])


def array_of_member(member: bytes) -> np.ndarray | bytes:
    """The array of one ``.npy`` member; of an array of Python objects, the pickle as bytes (not run).

    Raises:
        ValueError: no ``.npy``, or its header claims another size than the member has.
    """
    stream = io.BytesIO(member)
    version = npy.read_magic(stream)
    readers = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}
    if version not in readers:
        raise ValueError(f"unknown version {version} of the .npy format")
    shape, fortran_order, dtype = readers[version](stream)
    if dtype.hasobject:
        return member[stream.tell() :]
    count = 1
    for length in shape:
        count *= int(length)
    if count < 0 or count * dtype.itemsize != len(member) - stream.tell():
        raise ValueError(f"its header claims shape {shape}, the data hold another size")
    if count == 0 or dtype.itemsize == 0:
        return np.zeros(shape, dtype=dtype)
    flat = np.frombuffer(member, dtype=dtype, count=count, offset=stream.tell())
    return flat.reshape(shape, order="F" if fortran_order else "C")
