"""The header of a PLY file: elements and their properties, checked against the length of the file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1",
    "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2",
    "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "int64": "i8", "uint64": "u8",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
_ENCODINGS = {"ascii": "ascii", "binary_little_endian": "<", "binary_big_endian": ">"}
_LONGEST_HEADER = 1 << 20

Encoding = Literal["ascii", "<", ">"]


@dataclass(frozen=True)
class Property:
    """One column of an element, or a list of varying length in it.

    Attributes:
        name: as in the file.
        kind: numpy type without byte order, for instance "f4".
        count_kind: type of a list's length; None for a plain number.
    """

    name: str
    kind: str
    count_kind: str | None = None


@dataclass(frozen=True)
class Element:
    """A table of a PLY file: ``count`` rows of ``properties``."""

    name: str
    count: int
    properties: tuple[Property, ...]

    @property
    def has_lists(self) -> bool:
        """Whether rows may differ in length."""
        return any(column.count_kind for column in self.properties)

    def least_bytes(self, encoding: Encoding) -> int:
        """Bytes that the shortest possible rows of this element take."""
        if encoding == "ascii":
            return self.count * 2 * len(self.properties) - 1 if self.properties else 0
        return self.count * sum(int((column.count_kind or column.kind)[1:]) for column in self.properties)


def parse_ply_header(data: bytes) -> tuple[Encoding, tuple[Element, ...], int]:
    """The encoding, the elements in order, and where the body begins.

    Raises:
        ValueError: no PLY header, an unknown type, or more rows than the file can hold.
    """
    if data[:3] != b"ply":
        raise ValueError("expected 'ply' as the first word")
    end = data.find(b"end_header", 0, _LONGEST_HEADER)
    if end < 0:
        raise ValueError("the header has no 'end_header'")
    newline = data.find(b"\n", end)
    body = newline + 1 if newline >= 0 else len(data)
    encoding: str | None = None
    elements: list[Element] = []
    for line in data[:end].decode("latin-1").replace("\r", "\n").split("\n")[1:]:
        words = line.split()
        if not words or words[0] in ("comment", "obj_info"):
            continue
        if words[0] == "format" and len(words) >= 2:
            encoding = _ENCODINGS.get(words[1])
        elif words[0] == "element" and len(words) == 3 and words[2].isdecimal():
            elements.append(Element(words[1], int(words[2]), ()))
        elif words[0] == "property" and elements:
            last = elements[-1]
            elements[-1] = Element(last.name, last.count, (*last.properties, _property(words)))
        else:
            raise ValueError(f"the header has the line {line[:60]!r}, which is none of PLY's")
    if encoding is None:
        raise ValueError(f"the header's format is none of {', '.join(_ENCODINGS)}")
    checked: Encoding = "ascii" if encoding == "ascii" else "<" if encoding == "<" else ">"
    _check_length(elements, checked, len(data) - body)
    return checked, tuple(elements), body


def _property(words: list[str]) -> Property:
    if len(words) == 3 and words[1] in _TYPES:
        return Property(words[2], _TYPES[words[1]])
    if len(words) == 5 and words[1] == "list" and words[2] in _TYPES and words[3] in _TYPES:
        count_kind = _TYPES[words[2]]
        if count_kind.startswith("f"):
            raise ValueError(f"the list {words[4]!r} has a length of type {words[2]}; expected whole numbers")
        return Property(words[4], _TYPES[words[3]], count_kind)
    raise ValueError(f"the property {' '.join(words[1:])[:60]!r} is of no type that PLY knows")


def _check_length(elements: list[Element], encoding: Encoding, body_bytes: int) -> None:
    """Refuse before anything is allocated: counts are told by the file and may be anything."""
    needed = sum(element.least_bytes(encoding) for element in elements)
    if needed > body_bytes:
        told = ", ".join(f"{element.count} of {element.name}" for element in elements)
        raise ValueError(
            f"the header says {told}, which need {needed} bytes at least, but {body_bytes} follow: the file "
            "is cut off or its header is wrong"
        )
