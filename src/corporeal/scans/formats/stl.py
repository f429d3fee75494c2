"""STL, binary and ASCII: triangle soups."""

from __future__ import annotations

import re

import numpy as np

from corporeal.scans.raw import RawScan, numbers

_HEADER_BYTES = 84
_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_VERTEX = re.compile(rb"\bvertex[ \t]+(\S+)[ \t]+(\S+)[ \t]+(\S+)", re.IGNORECASE)
_FACET = re.compile(rb"\bendfacet\b", re.IGNORECASE)


def parse_stl(data: bytes) -> RawScan:
    """The soup of an STL file; every triangle has its own three points.

    The length decides between the two kinds, not the first word: binary files also begin with "solid".

    Raises:
        ValueError: the length does not fit the number of triangles, or the text is not that of an STL.
    """
    told = int.from_bytes(data[80:_HEADER_BYTES], "little") if len(data) >= _HEADER_BYTES else -1
    needed = _HEADER_BYTES + told * _TRIANGLE.itemsize
    if told >= 0 and len(data) == needed:
        return _binary(data, told, ())
    if data.lstrip()[:5].lower() == b"solid" and _FACET.search(data):
        return _ascii(data)
    if told > 0 and len(data) > needed:
        return _binary(data, told, (f"Bytes after the last triangle ignored: {len(data) - needed}.",))
    if told < 0:
        raise ValueError("expected an STL: either 'solid' and facets, or a header of 84 bytes")
    raise ValueError(
        f"the header says {told} triangles, which need {needed} bytes, but the file has {len(data)}: "
        "it is cut off or no STL"
    )


def _binary(data: bytes, count: int, notes: tuple[str, ...]) -> RawScan:
    triangles = np.frombuffer(data, dtype=_TRIANGLE, count=count, offset=_HEADER_BYTES)
    with np.errstate(invalid="ignore"):  # signalling NaN: cleaning drops such points and says so
        corners = triangles["corners"].astype(np.float64)
    return _soup(corners.reshape(-1, 3), notes)


def _ascii(data: bytes) -> RawScan:
    words = [word for corner in _VERTEX.findall(data) for word in corner]
    facets = len(_FACET.findall(data))
    if len(words) != 9 * facets:
        raise ValueError(f"{len(words) // 3} vertices in {facets} facets; expected three in each")
    return _soup(numbers(words, "vertex").reshape(-1, 3), ())


def _soup(points: np.ndarray, notes: tuple[str, ...]) -> RawScan:
    faces = np.arange(len(points), dtype=np.int64).reshape(-1, 3)
    return RawScan(points, faces, notes=notes)
