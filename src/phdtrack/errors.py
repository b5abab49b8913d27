"""Errors that a user can fix, and bounds on settings that raise them.

Every message reports the expected and the actual value, the location (file, line, frame or option)
and the likely cure, in one or two sentences. The command line prints it without a traceback and
exits with status 2.

Bounds are stated once, in the annotation of a field, and checked whenever a record of settings is
constructed:

    @dataclass(frozen=True)
    class Sensor(Checked):
        detection: Probability = 0.95
"""

from __future__ import annotations

import difflib
import math
import operator
import signal
from collections.abc import Iterable
from dataclasses import fields
from functools import cache
from importlib import import_module
from numbers import Real
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin, get_type_hints

from annotated_types import Ge, Gt, Le, Lt

from phdtrack.addresses import shown

Probability = Annotated[float, Ge(0), Le(1)]
Share = Annotated[float, Gt(0), Le(1)]
Positive = Annotated[float, Gt(0)]
NonNegative = Annotated[float, Ge(0)]
Count = Annotated[int, Ge(0)]
PositiveCount = Annotated[int, Ge(1)]

_TESTS = {Ge: ("at least", "ge"), Gt: ("above", "gt"), Le: ("at most", "le"), Lt: ("below", "lt")}

EXTRAS = {
    "av": "phdtrack[video]",
    "cv2": "phdtrack[opencv]",
    "matplotlib": "phdtrack[report]",
    "starlette": "phdtrack[web]",
    "uvicorn": "phdtrack[web]",
    "onnxruntime": "phdtrack[onnx]",
    "pyarrow": "phdtrack[parquet]",
    "paho": "phdtrack[mqtt]",
    "ray": "phdtrack[ray]",
}
"""Extras that install the optional packages, by the names of their modules."""

# A longer sentence loses its middle: the wrong value may have many thousand characters.
_LONGEST = 4000


def _sentence(text: str) -> str:
    """The text without secrets, and without its middle if it is very long."""
    text = shown(text)
    if len(text) <= _LONGEST:
        return text
    return f"{text[: _LONGEST // 2]} … {text[-_LONGEST // 4 :]}"


class InputError(ValueError):
    """Wrong input that the user can fix. User names and passwords of addresses are masked.

    Parameters
    ----------
    problem : the expected and the actual value.
    where : file, option or frame of the problem ("det.txt, line 12").
    cure : the likely cure; may be empty.
    """

    def __init__(self, problem: str, *, where: str | Path = "", cure: str = "") -> None:
        self.problem = _sentence(problem)
        self.where = _sentence(str(where))
        self.cure = _sentence(cure)
        text = self.problem
        if self.where:
            text = f"{self.where}: {self.problem}"
        if cure:
            text = f"{text.rstrip('.')}. {self.cure}"
        super().__init__(text)


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """The cure for a name that is not among the ``known``: the nearest of them, or all."""
    names = list(known)
    close = difflib.get_close_matches(name, names, 1)
    if close:
        return f"Did you mean {close[0]}?"
    return f"There are {', '.join(names) or 'none'}."


def needed(module: str) -> Any:
    """The module of an optional package; `InputError` names the extra to install if it is
    missing.
    """
    try:
        return import_module(module)
    except ImportError as error:
        raise absent(error, module) from None


def absent(error: ImportError, module: str = "") -> InputError:
    """The error that names the package to install if a ``module``, or one that it needs, is
    missing.

    Raises ``error`` if the package is unknown.
    """
    name = (error.name or module).partition(".")[0]
    package = EXTRAS.get((module or name).partition(".")[0]) or EXTRAS.get(name)
    if not (package or module):
        raise error
    return InputError(f"this needs the package {name}", cure=f"pip install '{package or module}'")


INTERRUPTING: list[object] = [signal.default_int_handler]
"""Handlers of Ctrl-C that raise KeyboardInterrupt."""
DEFERRED: list[int] = []
"""Signals that wait for the end of a block that must not be interrupted."""


def later(number: int, frame: object) -> None:
    """The handler of Ctrl-C in such a block. A second one does not wait."""
    DEFERRED.append(number)
    if len(DEFERRED) > 1:
        raise KeyboardInterrupt


def interrupted(error: BaseException) -> bool:
    """True if ``error`` is Ctrl-C or was caused by it: some compiled code of Numba turns it into a
    SystemError.
    """
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, KeyboardInterrupt):
            return True
        cause = cause.__cause__ or cause.__context__
    return False


@cache
def bounds(kind: type[Any]) -> tuple[tuple[str, tuple[Any, ...]], ...]:
    """Pairs (field, its bounds) of the fields of a dataclass with bounds in their annotations."""
    hints = get_type_hints(kind, include_extras=True)
    bounded = []
    for field in fields(kind):
        hint = hints[field.name]
        # All elements of a tuple have the bounds of the first.
        if get_origin(hint) is tuple:
            hint = get_args(hint)[0]
        if get_origin(hint) is Annotated:
            bounded.append((field.name, get_args(hint)[1:]))
    return tuple(bounded)


class Checked:
    """A dataclass whose fields are within the bounds of their annotations."""

    __slots__ = ()

    def __post_init__(self) -> None:
        check(self)


def check(settings: Any) -> None:
    """Raise `InputError` if a field of the dataclass ``settings`` breaks its annotation's bounds or
    is not finite.
    """
    record: Any = type(settings)
    for name, limits in bounds(record):
        values = getattr(settings, name)
        if not isinstance(values, tuple):
            values = (values,)
        for value in values:
            _check_number(value, limits, f"{record.__name__}.{name}")


def _check_number(value: Any, limits: tuple[Any, ...], where: str) -> None:
    """Raise `InputError` if the value is no finite number within the limits."""
    if isinstance(value, bool) or not isinstance(value, Real):
        raise InputError(f"expected a number, got {value!r}", where=where)
    if not math.isfinite(value):
        raise InputError(f"expected a number that is finite, got {value:g}", where=where)
    for limit in limits:
        words, attribute = _TESTS[type(limit)]
        bound = getattr(limit, attribute)
        if not getattr(operator, attribute)(value, bound):
            raise InputError(f"expected a value {words} {bound:g}, got {value:g}", where=where)
