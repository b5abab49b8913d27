"""Records of a saved state, made by the types of their fields; and the digest of settings, by which
a state of other settings is refused.

No class is looked up by a name in the state: a record is one of those that the annotations name,
or of the type that the state has before the first frame.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import is_dataclass
from functools import cache
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np

from phdtrack.errors import InputError
from phdtrack.state.binary import PackedRecord, field_names, is_record
from phdtrack.types import ParticleBlocks, Particles


def unpack(packed: Any, hint: Any, like: Any = None, where: str = "state") -> Any:
    """The value that `to_bytes` was given, from what `from_bytes` returned.

    Parameters
    ----------
    packed : numbers, arrays and containers, with a `PackedRecord` in place of each record.
    hint : the type of the value, as an annotation states it.
    like : the same value before the first frame; its type stands in for an open annotation.
    where : the place in the state, for errors.

    Raises
    ------
    InputError : a value is of another type than its annotation.
    """
    origin = get_origin(hint)
    arguments = get_args(hint)
    if hint in (bool, int, float, str):
        return _scalar(packed, hint, where)
    if origin is Literal:
        return _scalar(packed, str, where)
    if origin is np.ndarray:
        scalar = get_args(arguments[1])[0]
        return _array(packed, get_origin(scalar) or scalar, like, where)
    if origin is tuple:
        return _tuple(packed, arguments, like, where)
    if origin is dict:
        _expect(isinstance(packed, dict), "a dictionary", packed, where)
        key_hint, value_hint = arguments
        return {
            unpack(key, key_hint, where=where): unpack(value, value_hint, where=f"{where}[{key}]")
            for key, value in packed.items()
        }
    if origin in (Union, UnionType):
        candidates = arguments
    elif isinstance(hint, type) and is_record(hint):
        candidates = (hint,)
    else:
        candidates = _open_types(like)
    return _record(packed, candidates, like, where)


def _scalar(packed: Any, kind: type[Any], where: str) -> Any:
    """A number or text. A float may be saved as a whole number; kernels are compiled for floats."""
    if kind is float and type(packed) is int:
        return float(packed)
    _expect(type(packed) is kind, kind.__name__, packed, where)
    return packed


def _array(packed: Any, scalar: Any, like: Any, where: str) -> Any:
    """An array whose scalars are of this type. Arrays of records get the type of those in
    ``like``.
    """
    _expect(isinstance(packed, np.ndarray), "an array", packed, where)
    _expect(
        np.issubdtype(packed.dtype, scalar), f"an array of {scalar.__name__}", packed.dtype, where
    )
    if packed.dtype.names and like is not None:
        columns = like.dtype.descr
        _expect(packed.dtype.descr == columns, f"records of {columns}", packed.dtype, where)
        return packed.view(like.dtype)
    return packed


def _tuple(packed: Any, hints: tuple[Any, ...], like: Any, where: str) -> Any:
    """A tuple of the types in ``hints``, or with an ellipsis of any length."""
    _expect(isinstance(packed, tuple), "a tuple", packed, where)
    first = like[0] if like else None
    if hints[-1] is ...:
        return tuple(unpack(item, hints[0], first, where) for item in packed)
    _expect(len(packed) == len(hints), f"{len(hints)} values", packed, where)
    return tuple(unpack(item, hint, where=where) for item, hint in zip(packed, hints, strict=True))


def _record(packed: Any, candidates: tuple[Any, ...], like: Any, where: str) -> Any:
    """A record of the candidate that the packed one names; None where that is a candidate."""
    if packed is None and type(None) in candidates:
        return None
    names = " or ".join(kind.__name__ for kind in candidates)
    _expect(isinstance(packed, PackedRecord), names, packed, where)
    matching = [kind for kind in candidates if kind.__name__ == packed.name and is_record(kind)]
    _expect(bool(matching), names, packed, where)
    kind = matching[0]
    hints = _hints(kind)
    _expect(len(packed.values) == len(hints), f"{len(hints)} fields of {names}", packed, where)
    made = dict[str, Any]()
    for (name, hint), value in zip(hints.items(), packed.values, strict=True):
        before = getattr(like, name) if type(like) is kind else None
        made[name] = unpack(value, hint, before, f"{where}.{name}")
    return kind(**made)


@cache
def _hints(kind: Any) -> dict[str, Any]:
    """The types of a record's fields, in their order."""
    hints = get_type_hints(kind)
    return {name: hints[name] for name in field_names(kind)}


def _open_types(like: Any) -> tuple[Any, ...]:
    """The types that a state may have whose annotation leaves it open."""
    # A particle filter begins with an unordered set, and keeps it in blocks from then on.
    if isinstance(like, Particles):
        return (Particles, ParticleBlocks)
    return (type(like),)


def _expect(holds: bool, expected: str, packed: Any, where: str) -> None:
    """Raise `InputError` unless the condition holds."""
    if holds:
        return
    if isinstance(packed, PackedRecord):
        got = packed.name
    elif isinstance(packed, np.dtype):
        got = str(packed)
    else:
        got = type(packed).__name__
    cure = "It is of a tracker with other settings, or of another version"
    raise InputError(f"expected {expected}, got {got}", where=where, cure=cure)


def settings_digest(settings: Any) -> str:
    """A text that is the same for equal settings, in every process.

    It covers the types and values of all parts of dataclasses, named tuples, mappings, sequences
    and arrays; of any other object its class.
    """
    digest = hashlib.blake2b(digest_size=16)
    for part in _parts(settings):
        digest.update(len(part).to_bytes(8, "little") + part)
    return digest.hexdigest()


def _parts(value: Any) -> list[bytes]:
    """The bytes that decide `settings_digest`."""
    if isinstance(value, np.generic):
        value = value.item()
    kind = type(value)
    parts = [f"{kind.__module__}.{kind.__qualname__}".encode()]
    inside: list[Any] = []
    if isinstance(value, np.ndarray):
        parts += [f"{value.dtype.str}{value.shape}".encode(), value.tobytes()]
    elif value is None or isinstance(value, (bool, int, float, str)):
        parts.append(repr(value).encode())
    elif is_dataclass(value) or is_record(kind):
        inside = [getattr(value, name) for name in field_names(kind)]
    elif isinstance(value, Mapping):
        inside = [item for key in sorted(value, key=repr) for item in (key, value[key])]
    elif isinstance(value, (tuple, list)):
        inside = list(value)
    for item in inside:
        parts += _parts(item)
    return parts
