"""Records made of what was packed, with every part checked (`forms`); nothing but records of this
package is made.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import fields, is_dataclass
from functools import cache, partial
from importlib import import_module
from types import UnionType
from typing import Any, Literal, NamedTuple, Union, get_args, get_origin, get_type_hints

import numpy as np

from phdtrack.errors import InputError
from phdtrack.state.forms import FORMS, LARGEST, RELATIONS, SYMBOLS, World

# Probabilities are sums.
_ROUNDING = 1e-9
# By how much correlations of a covariance may be off after many updates.
_INEXACT = 1e-3
# Whole numbers that can still be added to.
_WHOLE = 2.0**53
_DTYPES: dict[Any, tuple[str, ...]] = {
    np.float64: ("f8",),
    np.int64: ("i8",),
    np.bool_: ("?",),
    np.void: ("V",),
}
_REAL = ("f4", "f8")

Reader = Callable[[Any, Any, World, str], Any]


class _Field(NamedTuple):
    """A line of `FORMS`; bounds are numbers or names."""

    name: str
    column: str
    shape: tuple[str, ...] | None
    low: float | str
    high: float | str
    more: frozenset[str]

    @classmethod
    def of(cls, line: str) -> _Field:
        """Of a word of `FORMS`."""
        name, shape, bounds, more = (*line.split(":"), "", "", "")[:4]
        name, _, column = name.partition(".")
        low, _, high = bounds.partition("..")
        words = frozenset(filter(None, more.split(",")))
        return cls(
            name,
            column,
            tuple(shape.split(",")) if shape else None,
            _limit(low),
            _limit(high),
            words,
        )


def _limit(word: str) -> float | str:
    """The number that a bound is; its name where that is not known yet; empty for none."""
    try:
        if word in SYMBOLS:
            return SYMBOLS[word]
        return float(word)
    except ValueError:
        return word


@cache
def is_record(kind: Any) -> bool:
    """Whether this is a dataclass or a named tuple of this package."""
    ours = isinstance(kind, type) and kind.__module__.startswith("phdtrack.")
    return ours and (is_dataclass(kind) or issubclass(kind, tuple))


@cache
def names_of(kind: Any) -> tuple[str, ...]:
    """The fields of a record."""
    return tuple(field.name for field in fields(kind)) if is_dataclass(kind) else kind._fields


def pack(value: Any) -> Any:
    """Dictionaries, lists, numbers and copies of arrays, of which `restored` makes the same value.
    Raises `InputError` for a value of something else than numbers, arrays, tuples, dictionaries and
    this package's records."""
    kind: Any = type(value)
    if is_record(kind):
        inside = {name: pack(getattr(value, name)) for name in names_of(kind)}
        return {"record": f"{kind.__module__}:{kind.__name__}", "fields": inside}
    if isinstance(value, np.ndarray):
        return value.copy()
    if isinstance(value, tuple):
        return [pack(item) for item in value]
    if isinstance(value, dict):
        return {
            "record": "dict",
            "keys": list(value),
            "values": [pack(item) for item in value.values()],
        }
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    raise InputError(f"a state of type {kind.__name__} cannot be saved", where="state_dict")


def restored(packed: Any, hint: Any, like: Any, world: World, where: str) -> Any:
    """The value that was packed, checked: every type, shape and range, and how they fit each other.
    Only records of this package are made. `InputError` names the place in the state that is wrong.

    Parameters
    ----------
    packed, hint : what `pack` made, and the type that is expected, as annotations state it.
    like : the same value before the first frame; what is open in the annotation has its type.
    world, where : what it must fit, and its place, for errors.
    """
    try:
        return _reader(hint)(packed, like, world, where)
    except (OverflowError, RecursionError) as error:
        raise _wrong(where, f"this is no state ({error})") from None


def _wrong(where: str, problem: str) -> InputError:
    """The error of a place in a state."""
    return InputError(
        problem, where=where, cure="It is damaged, or of a tracker with other settings"
    )


def _named(packed: Any) -> str:
    """The name of the record that this is; empty where it is none."""
    if isinstance(packed, dict):
        name = packed.get("record")
    else:
        name = None
    return name if isinstance(name, str) else ""


@cache
def _reader(hint: Any) -> Reader:
    """What reads values of a type."""
    kind = get_origin(hint)
    inside = get_args(hint)
    if hint in (int, float, bool, str):
        return partial(
            _number, {int: (int,), float: (float, int), bool: (bool,), str: (str,)}[hint]
        )
    if kind is Literal:
        return partial(_number, (str,))
    if kind is np.ndarray:
        return partial(_array, _DTYPES.get(get_args(inside[1])[0], _REAL))
    if kind is tuple:
        return partial(
            _tuple, [_reader(one) for one in inside if one is not ...], inside[-1] is ...
        )
    if kind is dict:
        return partial(_dictionary, _reader(inside[0]), _reader(inside[1]))
    if kind in (Union, UnionType):
        return partial(_one_of, {one.__name__: _reader(one) for one in inside})
    if is_record(hint):
        return partial(_record, hint)
    return _open


def _number(kinds: tuple[type[Any], ...], packed: Any, like: Any, world: World, where: str) -> Any:
    if not isinstance(packed, kinds) or (isinstance(packed, bool) and bool not in kinds):
        raise _wrong(where, f"expected {kinds[0].__name__}, got {type(packed).__name__}")
    # Compiled code makes a difference between 1 and 1.0.
    made: Any = packed
    if kinds[0] is float:
        return float(made)
    return made


def _array(dtypes: tuple[str, ...], packed: Any, like: Any, world: World, where: str) -> Any:
    name = where.rpartition(".")[2]
    records = dtypes == ("V",)
    if records:
        wanted = [_columns(name)]
    else:
        wanted = [np.dtype(one) for one in dtypes]
    if type(packed) is not np.ndarray or packed.dtype.descr not in [one.descr for one in wanted]:
        if isinstance(packed, np.ndarray):
            got = packed.dtype
        else:
            got = type(packed).__name__
        raise _wrong(where, f"expected an array of {' or '.join(map(str, wanted))}, got {got}")
    made = packed.copy()
    if records:
        return made.view(wanted[0])
    return made


def _columns(name: str) -> np.dtype[np.void]:
    """The type of the records of `kernels.pmb`, which is loaded where there are some."""
    from phdtrack.kernels.pmb import HYPOTHESIS, TARGET

    if name == "targets":
        return TARGET
    return HYPOTHESIS


def _tuple(
    readers: list[Reader], endless: bool, packed: Any, like: Any, world: World, where: str
) -> Any:
    if not isinstance(packed, (list, tuple)) or not (endless or len(packed) == len(readers)):
        raise _wrong(where, f"expected {'some' if endless else len(readers)} values in a row")
    return tuple(
        readers[0 if endless else k](one, None, world, f"{where}[{k}]")
        for k, one in enumerate(packed)
    )


def _dictionary(
    key: Reader, value: Reader, packed: Any, like: Any, world: World, where: str
) -> Any:
    if _named(packed) != "dict" or packed.keys() != {"record", "keys", "values"}:
        raise _wrong(where, "expected keys and values")
    keys, values = (packed[name] for name in ("keys", "values"))
    if not isinstance(keys, list) or not isinstance(values, list) or len(keys) != len(values):
        raise _wrong(where, "expected as many keys as values")
    names = [key(one, None, world, f"{where}, key {k}") for k, one in enumerate(keys)]
    return {
        name: value(one, None, world, f"{where}[{name}]")
        for name, one in zip(names, values, strict=True)
    }


def _one_of(readers: dict[str, Reader], packed: Any, like: Any, world: World, where: str) -> Any:
    if packed is None and "NoneType" in readers:
        return None
    return (readers.get(_named(packed).partition(":")[2]) or next(iter(readers.values())))(
        packed, like, world, where
    )


def _open(packed: Any, like: Any, world: World, where: str) -> Any:
    """A value of the type that the state before the first frame has."""
    if packed is None and like is None:
        return None
    found = _named(packed)
    module, _, record = found.partition(":")
    usual = type(like).__name__
    allowed: tuple[str, ...]
    if usual == "Particles":
        allowed = (usual, "ParticleBlocks")
    else:
        allowed = (usual,)
    if record not in allowed or not module.startswith("phdtrack."):
        raise _wrong(
            where, f"expected {' or '.join(allowed)}, got {found or type(packed).__name__}"
        )
    kind: Any = type(like)
    if kind.__name__ == record:
        return _reader(kind)(packed, like, world, where)
    kind = None
    with suppress(ImportError, AttributeError):
        kind = getattr(import_module(module), record)
    if not is_record(kind):
        raise _wrong(where, f"this version does not know a record {found!r}")
    return _reader(kind)(packed, None, world, where)


@cache
def _plan(kind: Any) -> tuple[dict[str, Reader], list[_Field]]:
    """How the fields of a record are read, and their forms: of numbers, that they are finite, where
    nothing else is said.
    """
    hints = get_type_hints(kind)
    names = names_of(kind)
    form = [_Field.of(line) for line in FORMS.get(kind.__name__, "").split()]
    known = {field.name for field in form}
    form += [
        _Field.of(f"{name}::")
        for name in names
        if hints[name] in (int, float) and name not in known
    ]
    arrays = {name for name in names if get_origin(hints[name]) is np.ndarray}
    assert arrays <= known, f"no form of {kind.__name__}"
    return {name: _reader(hints[name]) for name in names}, form


def _record(kind: Any, packed: Any, like: Any, world: World, where: str) -> Any:
    """A record of this type."""
    full = f"{kind.__module__}:{kind.__name__}"
    if _named(packed) == full:
        inside = packed.get("fields")
    else:
        inside = None
    readers, form = _plan(kind)
    if not isinstance(inside, dict) or inside.keys() != readers.keys():
        raise _wrong(where, f"expected a {kind.__name__}")
    if type(like) is kind:
        before = like
    else:
        before = None
    found = {
        n: read(inside[n], getattr(before, n, None), world, f"{where}.{n}")
        for n, read in readers.items()
    }
    _check(found, form, world, where)
    try:
        made = kind(**found)
    except InputError as error:
        raise _wrong(where, error.problem) from None
    relation = RELATIONS.get(kind.__name__)
    if relation is not None and not relation(made, world):
        raise _wrong(where, f"the parts of this {kind.__name__} do not fit each other")
    return made


def _check(found: dict[str, Any], form: list[_Field], world: World, where: str) -> None:
    """Raise `InputError` where a field is not of its form."""
    known = dict[str, int]()
    for field in form:
        if field.column:
            value = found[field.name][field.column]
        else:
            value = found[field.name]
        if field.shape is not None and not _has_shape(value, field.shape, known, world.sizes):
            problem = f"expected an array of shape ({', '.join(field.shape)}), got {value.shape}"
            raise _wrong(f"{where}.{field.name}", f"{problem} beside {known | world.sizes}")
    for field in form:
        if field.column:
            value = found[field.name][field.column]
        else:
            value = found[field.name]
        if not _is_good(value, field, found, known):
            low, high = (
                f"{one:g}" if isinstance(one, float) else one for one in (field.low, field.high)
            )
            if low:
                bounds = f"from {low} to {high}".removesuffix(" to ")
            else:
                bounds = "that are finite"
            more = " and ".join(sorted(_SAID[one] for one in field.more if one in _SAID))
            raise _wrong(
                f"{where}.{field.name}", f"expected numbers {bounds}{more and f', {more}'}"
            )


_SAID = {
    "up": "ascending",
    "rise": "ascending, none twice",
    "cov": "of covariances with variances above 0",
    "cov0": "of covariances",
}


def _has_shape(
    value: Any, shape: tuple[str, ...], known: dict[str, int], world: dict[str, int]
) -> bool:
    """Whether an array has this shape; lengths that are not known yet are known then."""
    if value.ndim != len(shape):
        return False
    nothing = any(
        length == 0 and not word.endswith("?")
        for length, word in zip(value.shape, shape, strict=True)
    )
    for length, word in zip(value.shape, shape, strict=True):
        if word.isdecimal():
            if length != int(word):
                return False
            continue
        letter = word[0]
        less = 1 if word.endswith("+1") else 0
        if word.endswith("?") and length == 0 and nothing:
            continue
        if (
            length < less
            or (world if letter in "dm" else known).setdefault(letter, length - less)
            != length - less
        ):
            return False
    return True


def _bound(limit: float | str, usual: float, found: dict[str, Any], known: dict[str, int]) -> float:
    """A bound: a number, or a name, less 1 where it says so."""
    if isinstance(limit, float):
        return limit
    name = limit.removesuffix("-1")
    if limit:
        return float(known[name] if name in known else found[name]) - (name != limit)
    return usual


def _is_good(value: Any, field: _Field, found: dict[str, Any], known: dict[str, int]) -> bool:
    """Whether all numbers are within the bounds, and what else is said of them."""
    array = isinstance(value, np.ndarray)
    if array and (not value.size or value.dtype.kind in "bV"):
        return True
    if isinstance(value, int) or (array and value.dtype.kind == "i"):
        usual = _WHOLE
    else:
        usual = LARGEST
    low = _bound(field.low, -usual, found, known)
    high = _bound(field.high, usual, found, known)
    if not array:
        return low <= value <= high or ("nan" in field.more and math.isnan(value))
    if "nan" in field.more or "inf" in field.more:
        if "inf" in field.more:
            bad = np.isnan(value)
        else:
            bad = np.isinf(value)
        return {"nan", "inf"} <= field.more or not bad.any()
    # NaN is the least and the greatest.
    if not (
        low - _ROUNDING <= np.minimum.reduce(value, None)
        and np.maximum.reduce(value, None) <= high + _ROUNDING
    ):
        return False
    if "up" in field.more or "rise" in field.more:
        steps = np.diff(value)
        return bool(
            len(steps) == 0 or (steps.min() > 0 if "rise" in field.more else steps.min() >= 0)
        )
    if "cov" in field.more or "cov0" in field.more:
        return _is_covariance(value, definite="cov" in field.more)
    return True


def _is_covariance(value: np.ndarray[Any, Any], *, definite: bool) -> bool:
    """Whether all are covariances but for rounding: (n, d, d), symmetric, no correlation that
    others do not allow, and variances from 0, or above it where they are ``definite``."""
    variance = value.diagonal(axis1=1, axis2=2)
    if not variance.size:
        return True
    if variance.min() < 0 or (definite and variance.min() == 0):
        return False
    deviation = np.sqrt(np.where(variance > 0, variance, 1.0))
    correlation = value / deviation[:, :, None] / deviation[:, None, :]
    skew = np.abs(correlation - correlation.transpose(0, 2, 1)).max()
    return bool(skew <= _INEXACT and np.linalg.eigvalsh(correlation).min() >= -_INEXACT)
