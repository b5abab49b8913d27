"""The variables of a MATLAB 5 file, as far as cameras need them: arrays of numbers, texts, cells and structs.

A file is a header of 128 bytes and elements: type, size, content. The element of a variable holds others: flags, dimensions,
name, and the values, or the elements of a cell's or a struct's parts. Elements may be compressed. Sizes in a file are but
claims: nothing is made of them that the bytes that are there cannot fill.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np

from phdtrack.errors import InputError

# Bytes that everything compressed may expand to, dimensions of an array, cells and structs within each other, their parts.
_LARGEST, _DIMENSIONS, _DEEPEST, _MOST_PARTS = 1 << 26, 32, 20, 100_000
_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_TEXTS = {1: "latin-1", 2: "latin-1", 4: "utf-16", 16: "utf-8", 17: "utf-16", 18: "utf-32"}
_MATRIX, _COMPRESSED = 14, 15
_ORDERS: dict[bytes, Literal["<", ">"]] = {b"IM\x00\x01": "<", b"MI\x01\x00": ">"}
_CELL, _STRUCT, _CHAR, _FIRST_NUMERIC, _LAST_NUMERIC = 1, 2, 4, 6, 15
_COMPLEX, _LOGICAL = 8, 2


class _Element(NamedTuple):
    """Type and content."""

    kind: int
    data: memoryview


def read_matlab(content: bytes) -> dict[str, Any]:
    """The variables by name: arrays as (…) float64, one line of text as ``str``, cells as lists, structs as dictionaries,
    arrays of them as lists of dictionaries. What is none of these (complex, logical, sparse, objects) is None.

    Raises
    ------
    InputError : it is no file of MATLAB 5 to 7, or it is damaged.
    """
    if content.startswith((b"MATLAB 7.3", b"\x89HDF")):
        raise InputError("expected a file of MATLAB 5 to 7, came one of version 7.3 (HDF5)", cure="Save it with -v7.")
    order: Literal["<", ">", ""] = _ORDERS.get(content[126:128] + content[124:126], "")
    if not order:
        problem = "expected a file of MATLAB 5 to 7, came one of version 4, or another kind of file"
        raise InputError(problem, cure="Save it with -v7.")
    try:
        return _Reader(order).variables(memoryview(content)[128:])
    except (zlib.error, struct.error) as error:
        raise _broken(str(error)) from None


def _broken(what: str) -> InputError:
    return InputError(f"the MATLAB file cannot be read: {what}", cure="Is it complete? Save it again, with -v7.")


@dataclass(slots=True)
class _Reader:
    """Reads elements in a byte ``order``; ``left`` bytes may still be expanded, and ``room`` parts be read."""

    order: Literal["<", ">"]
    left: int = _LARGEST
    room: int = _MOST_PARTS

    def variables(self, data: memoryview) -> dict[str, Any]:
        """Those that the elements hold."""
        found = {}
        for kind, inner in self.elements(data):
            if kind == _COMPRESSED:
                inner = self.expanded(inner)
                kind, inner = next(self.elements(inner), _Element(0, inner))
            if kind == _MATRIX:
                name, value = self.matrix(inner, 0)
                found[name] = value
        found.pop("", None)
        return found

    def expanded(self, data: memoryview) -> memoryview:
        """What is compressed."""
        out = zlib.decompressobj().decompress(data, self.left + 1)
        self.left -= len(out)
        if self.left < 0:
            raise _broken(f"it expands to more than {_LARGEST} bytes")
        return memoryview(out)

    def elements(self, data: memoryview) -> Iterator[_Element]:
        """One after the other."""
        at = 0
        while at < len(data):
            kind, size = struct.unpack_from(f"{self.order}II", data, at)
            begin, after = at + 8, at + 8 + size + (0 if kind == _COMPRESSED else -size % 8)
            if kind >> 16:
                # Up to four bytes stand in the place of the size.
                kind, size, begin, after = kind & 0xFFFF, kind >> 16, at + 4, at + 8
            if begin + size > (after if begin == at + 4 else len(data)):
                raise _broken(f"an element of {size} bytes is cut short")
            yield _Element(kind, data[begin : begin + size])
            at = after

    def next(self, elements: Iterator[_Element]) -> _Element:
        """The next of them, which must be there."""
        found = next(elements, None)
        if found is None:
            raise _broken("a part of a variable is missing")
        return found

    def numbers(self, element: _Element) -> Any:
        """(n,) the numbers of an element."""
        if element.kind not in _NUMBERS:
            raise _broken(f"expected numbers, came an element of type {element.kind}")
        kind = np.dtype(_NUMBERS[element.kind]).newbyteorder(self.order)
        if len(element.data) % kind.itemsize:
            raise _broken(f"{len(element.data)} bytes are no numbers of {kind.itemsize} bytes")
        return np.frombuffer(element.data, kind)

    def matrix(self, data: memoryview, depth: int) -> tuple[str, Any]:
        """Name and value of a variable, or of a part of one."""
        if not len(data):
            return "", np.zeros((0, 0))
        if depth > _DEEPEST:
            raise _broken(f"cells and structs are nested deeper than {_DEEPEST}")
        parts = self.elements(data)
        flags = self.numbers(self.next(parts))
        kind, marks = (int(flags[0]) & 0xFF, int(flags[0]) >> 8) if len(flags) else (0, 0)
        if kind not in (_CELL, _STRUCT, _CHAR) and not _FIRST_NUMERIC <= kind <= _LAST_NUMERIC:
            return "", None
        shape = [int(one) for one in self.numbers(self.next(parts))]
        if not 2 <= len(shape) <= _DIMENSIONS or min(shape) < 0:
            raise _broken(f"expected the size of an array, came {shape[:_DIMENSIONS]}")
        name = bytes(self.next(parts).data).decode("latin-1")
        count = math.prod(shape)
        if kind == _CELL:
            return name, self.parts(parts, count, len(data), depth)
        if kind == _STRUCT:
            return name, self.structs(parts, count, len(data), depth)
        values = self.next(parts)
        if kind == _CHAR:
            return name, self.text(values) if shape[0] <= 1 else None
        if marks & (_COMPLEX | _LOGICAL):
            return name, None
        array = self.numbers(values)
        if len(array) != count:
            raise _broken(f"expected {count} numbers for {name or 'an array'}, came {len(array)}")
        with np.errstate(all="ignore"):
            return name, array.astype(np.float64).reshape(shape, order="F")

    def text(self, element: _Element) -> str:
        """The characters of an element."""
        coding = _TEXTS.get(element.kind, "latin-1")
        order = {"<": "-le", ">": "-be"}[self.order] if coding in ("utf-16", "utf-32") else ""
        return bytes(element.data).decode(coding + order, errors="replace")

    def parts(self, elements: Iterator[_Element], count: int, size: int, depth: int) -> list[Any]:
        """The values of ``count`` elements among ``size`` bytes."""
        self.room -= count
        if 8 * count > size or self.room < 0:
            raise _broken(f"expected at most {min(size // 8, _MOST_PARTS)} parts of cells and structs, came {count} more")
        found = []
        for _ in range(count):
            kind, data = self.next(elements)
            if kind != _MATRIX:
                raise _broken(f"expected an array, came an element of type {kind}")
            found.append(self.matrix(data, depth + 1)[1])
        return found

    def structs(self, elements: Iterator[_Element], count: int, size: int, depth: int) -> Any:
        """One struct, or several, by the names of their fields."""
        width = self.numbers(self.next(elements))
        names = bytes(self.next(elements).data)
        step = int(width[0]) if len(width) == 1 else 0
        if step < 1 or len(names) % step:
            raise _broken("the names of a struct's fields are damaged")
        fields = [names[at : at + step].partition(b"\0")[0].decode("latin-1") for at in range(0, len(names), step)]
        if not fields:
            return {} if count == 1 else None
        values = self.parts(elements, count * len(fields), size, depth)
        rows = [dict(zip(fields, values[k : k + len(fields)], strict=True)) for k in range(0, len(values), len(fields))]
        return rows[0] if count == 1 else rows
