"""What a state holds as bytes: JSON and arrays, of which nothing but numbers, texts, lists and
arrays can be made again.

A block is length, checksum, content. So is every block of a file that grows by them, and one that
was cut off is found out.
"""

from __future__ import annotations

import json
import math
import re
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from phdtrack.errors import InputError

_HEAD = struct.Struct("<II")
# Bytes of a block; more is no block of ours.
_LONGEST = 1 << 30
_KINDS = "biuf"
_DTYPE = re.compile(r"[<>|][biuf](1|2|4|8)")


def _plain(dtype: np.dtype[Any]) -> bool:
    """Whether these are numbers, or records of numbers."""
    if dtype.names:
        return all(dtype[name].kind in _KINDS for name in dtype.names)
    return dtype.kind in _KINDS


def _dtype(said: Any) -> np.dtype[Any]:
    """The type of an array that a block names. Raises ``ValueError`` or ``TypeError`` where it is
    none of ours.
    """
    if isinstance(said, list):
        columns = said
    else:
        columns = [("", said)]
    if not all(_DTYPE.fullmatch(kind) for _, kind in columns):
        raise ValueError
    return np.dtype([(str(name), kind) for name, kind in said] if isinstance(said, list) else said)


def to_bytes(value: Any) -> bytes:
    """A block that holds dictionaries with texts as keys, lists, tuples, numbers, texts and arrays
    of numbers. Raises `InputError` for anything else."""
    arrays = list[bytes]()

    def plain(one: Any) -> Any:
        if isinstance(one, np.ndarray) and _plain(one.dtype):
            arrays.append(np.ascontiguousarray(one).tobytes())
            return {
                "array": [one.dtype.descr if one.dtype.names else one.dtype.str, list(one.shape)]
            }
        if isinstance(one, tuple):
            return {"tuple": [plain(item) for item in one]}
        if isinstance(one, list):
            return [plain(item) for item in one]
        if isinstance(one, dict) and all(type(key) is str for key in one):
            return {"dict": {key: plain(item) for key, item in one.items()}}
        if one is None or isinstance(one, (bool, int, float, str)):
            return one
        raise InputError(f"a value of type {type(one).__name__} cannot be saved")

    text = json.dumps(plain(value), separators=(",", ":")).encode()
    content = b"".join((struct.pack("<I", len(text)), text, *arrays))
    return _HEAD.pack(len(content), zlib.crc32(content)) + content


def from_bytes(block: bytes, where: str | Path = "") -> Any:
    """The value of one block. Raises `InputError` where it is cut off or changed, or no block of
    `to_bytes`.
    """
    problem = InputError("expected a saved state, which is cut off or changed", where=where)
    if len(block) < _HEAD.size + 4:
        raise problem
    length, checksum = _HEAD.unpack_from(block)
    content = memoryview(block)[_HEAD.size :]
    if length != len(content) or zlib.crc32(content) != checksum:
        raise problem
    (head,) = struct.unpack_from("<I", content)
    at = 4 + head

    def value(one: Any) -> Any:
        nonlocal at
        if isinstance(one, list):
            return [value(item) for item in one]
        if not isinstance(one, dict):
            return one
        ((kind, inside),) = one.items()
        if kind == "tuple":
            return tuple(value(item) for item in inside)
        if kind == "dict":
            return {str(key): value(item) for key, item in inside.items()}
        dtype = _dtype(inside[0])
        shape = [int(n) for n in inside[1]]
        size = math.prod(shape) * dtype.itemsize
        if kind != "array" or min(shape, default=0) < 0 or at + size > len(content):
            raise ValueError
        made = np.frombuffer(content[at : at + size], dtype).reshape(shape).copy()
        at += size
        return made

    try:
        made = value(json.loads(bytes(content[4 : 4 + head])))
    except (ValueError, TypeError, LookupError, AttributeError, RecursionError, OverflowError):
        raise problem from None
    if at != len(content):
        raise problem
    return made


def blocks(file: BinaryIO, where: str | Path = "") -> Iterator[tuple[int, Any]]:
    """Where in the file each whole block ends, and its value; what follows the last whole one is
    passed over.
    """
    end = file.tell()
    while True:
        head = file.read(_HEAD.size)
        if len(head) < _HEAD.size:
            return
        length = _HEAD.unpack(head)[0]
        if length <= _LONGEST:
            content = file.read(length)
        else:
            content = b""
        try:
            value = from_bytes(head + content, where)
        except InputError:
            return
        end += _HEAD.size + length
        yield end, value
