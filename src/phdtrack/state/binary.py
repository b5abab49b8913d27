"""Plain values and records as bytes: a header, JSON, and the arrays.

The header holds a magic word, the format number, the length and a checksum of what follows, so
that a block that was cut off, changed or written by another version is refused. Nothing is
executed when a block is read: it holds numbers, texts, arrays of numbers, and containers of these.
The checksum finds damage; it does not prove who wrote the block.
"""

from __future__ import annotations

import hashlib
import json
import math
import struct
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np

from phdtrack.errors import InputError

FORMAT = 35
"""The format number of blocks; it changes when a record that is saved gets other fields."""
_MAGIC = b"PHDT"
_CHECKSUM_SIZE = 16
# Magic word, format number, length of the content, checksum of the content.
_HEADER = struct.Struct(f"<4sIQ{_CHECKSUM_SIZE}s")
# Length of the JSON, with which the content begins.
_JSON_LENGTH = struct.Struct("<I")


class PackedRecord(NamedTuple):
    """The name of a record's class and its fields; `unpacking.unpack` makes the record of them."""

    name: str
    values: list[Any]


def to_bytes(value: Any) -> bytes:
    """A block that holds numbers, texts, bytes, arrays of numbers, and lists, tuples, dictionaries,
    dataclasses and named tuples of these.

    Raises
    ------
    InputError : the value holds something else.
    """
    arrays = list[bytes]()
    text = json.dumps(_to_json(value, arrays), separators=(",", ":")).encode()
    content = b"".join((_JSON_LENGTH.pack(len(text)), text, *arrays))
    return _HEADER.pack(_MAGIC, FORMAT, len(content), _checksum(content)) + content


def _to_json(value: Any, arrays: list[bytes]) -> Any:
    """The value for JSON; each object is of one key that tells the type. Arrays are appended."""
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if isinstance(value, np.ndarray) and not value.dtype.hasobject:
        arrays.append(value.tobytes())
        dtype = value.dtype.descr if value.dtype.names else value.dtype.str
        return {"array": [dtype, value.shape]}
    if isinstance(value, bytes):
        arrays.append(value)
        return {"bytes": len(value)}
    if isinstance(value, list):
        return [_to_json(item, arrays) for item in value]
    if isinstance(value, dict):
        return {"dict": [[_to_json(k, arrays), _to_json(v, arrays)] for k, v in value.items()]}
    if is_record(type(value)):
        items = [_to_json(getattr(value, name), arrays) for name in field_names(type(value))]
        return {"record": [type(value).__name__, *items]}
    if isinstance(value, tuple):
        return {"tuple": [_to_json(item, arrays) for item in value]}
    raise InputError(f"a value of type {type(value).__name__} cannot be saved", where="to_bytes")


def from_bytes(block: bytes, where: str | Path = "") -> Any:
    """The value of one block, with a `PackedRecord` in place of each record.

    Parameters
    ----------
    block : bytes from `to_bytes`.
    where : the file, for errors.

    Raises
    ------
    InputError : the block is no saved state, of another format, cut off or changed.
    """
    if len(block) < _HEADER.size or not block.startswith(_MAGIC):
        raise InputError("expected a saved state, which begins with other bytes", where=where)
    _, number, length, checksum = _HEADER.unpack_from(block)
    if number != FORMAT:
        raise other_format(number, where)
    content = memoryview(block)[_HEADER.size :]
    if length != len(content) or _checksum(content) != checksum:
        raise InputError("expected a saved state, which is cut off or changed", where=where)
    (json_length,) = _JSON_LENGTH.unpack_from(content)
    offset = _JSON_LENGTH.size + json_length

    def take(size: int) -> memoryview:
        nonlocal offset
        offset += size
        return content[offset - size : offset]

    def revive(item: dict[str, Any]) -> Any:
        ((kind, inside),) = item.items()
        if kind == "tuple":
            return tuple(inside)
        if kind == "dict":
            return dict(inside)
        if kind == "record":
            return PackedRecord(inside[0], inside[1:])
        if kind == "bytes":
            return bytes(take(inside))
        dtype = _dtype(inside[0])
        shape = inside[1]
        data = take(math.prod(shape) * dtype.itemsize)
        return np.frombuffer(data, dtype).reshape(shape).copy()

    return json.loads(bytes(content[_JSON_LENGTH.size : offset]), object_hook=revive)


def blocks(file: BinaryIO, where: str | Path = "") -> Iterator[tuple[int, Any]]:
    """The whole blocks of a file that grows by them: where each ends, and its value. What follows
    the last whole block is skipped.
    """
    end = file.tell()
    while True:
        header = file.read(_HEADER.size)
        if len(header) < _HEADER.size or not header.startswith(_MAGIC):
            return
        length = _HEADER.unpack(header)[2]
        try:
            value = from_bytes(header + file.read(length), where)
        except InputError:
            return
        end += _HEADER.size + length
        yield end, value


def other_format(number: object, where: str | Path) -> InputError:
    """The error for a state of another format."""
    problem = (
        f"this state is of format {number}, and this version of phdtrack reads format {FORMAT}"
    )
    cure = "Load it with the version that saved it, or begin anew"
    return InputError(problem, where=where, cure=cure)


def is_record(kind: type[Any]) -> bool:
    """True for a dataclass or a named tuple."""
    return is_dataclass(kind) or (issubclass(kind, tuple) and "_fields" in vars(kind))


def field_names(kind: Any) -> tuple[str, ...]:
    """The names of a record's fields."""
    if is_dataclass(kind):
        return tuple(field.name for field in fields(kind))
    names: tuple[str, ...] = kind._fields
    return names


def _checksum(content: bytes | memoryview) -> bytes:
    return hashlib.blake2b(content, digest_size=_CHECKSUM_SIZE).digest()


def _dtype(description: Any) -> np.dtype[Any]:
    """The dtype that a block names."""
    if isinstance(description, list):
        description = [tuple(column) for column in description]
    dtype: np.dtype[Any] = np.dtype(description)
    return dtype
