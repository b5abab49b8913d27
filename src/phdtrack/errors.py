"""Errors that a user can mend, and bounds on settings that raise them.

Every message says what was expected, what was found, where (file, line, frame or option) and the
likely cure, in one or two sentences. The command line prints it without a traceback and exits with
status 2.

Bounds are stated once, in the annotation of a field, and checked wherever a record of settings is
made:

    @dataclass(frozen=True)
    class Sensor(Checked):
        detection: Probability = 0.95
"""

from __future__ import annotations

import difflib
import math
import operator
import re
import signal
from collections.abc import Iterable
from dataclasses import fields
from functools import cache
from importlib import import_module
from numbers import Real
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin, get_type_hints

from annotated_types import Ge, Gt, Le, Lt

Probability = Annotated[float, Ge(0), Le(1)]
Share = Annotated[float, Gt(0), Le(1)]
Positive = Annotated[float, Gt(0)]
NonNegative = Annotated[float, Ge(0)]
Count = Annotated[int, Ge(0)]
PositiveCount = Annotated[int, Ge(1)]

_TESTS = {Ge: ("at least", "ge"), Gt: ("above", "gt"), Le: ("at most", "le"), Lt: ("below", "lt")}

EXTRAS = {
    "av": "phdtrack[video]",
    "matplotlib": "phdtrack[report]",
    "starlette": "phdtrack[web]",
    "uvicorn": "phdtrack[web]",
    "onnxruntime": "phdtrack[onnx]",
    "pyarrow": "phdtrack[parquet]",
    "paho": "phdtrack[mqtt]",
    "ray": "phdtrack[ray]",
    "rerun": "phdtrack[rerun]",
}
"""What installs the packages that `Tracker` does without, by the names of their modules."""

# Each place is looked at once, whatever stands there: a damaged file may be one long name. A
# password may hold a /, but what follows a host and its port is no password.
_PASSWORD = r"(?![^\s/:@]*[.\]][^\s/:@]*:\d+/)[^\s/:@]*:[^\s@]{1,100}"
_USER = re.compile(rf"(?i)([a-z0-9+.-]{{1,30}}://)(?:[^/\s]+|{_PASSWORD})@")
_PARAMETER = re.compile(r"([?&][^=&?]*=)[^&#\s]*")
_SECRET = re.compile(r"(?i)pass|pwd|token|secret|key|auth")
# A sentence of more characters loses its middle: what is wrong may be a value of many thousand.
_LONGEST = 4000


def shown(text: str) -> str:
    """The text, an address or a sentence, without user names, passwords and tokens of the addresses
    in it.
    """
    text = _USER.sub(r"\1…@", text)
    return _PARAMETER.sub(
        lambda found: f"{found[1]}…" if _SECRET.search(found[1]) else found[0], text
    )


def _sentence(text: str) -> str:
    """What may be shown of the text, without its middle where it is very long."""
    text = shown(text)
    if len(text) <= _LONGEST:
        return text
    return f"{text[: _LONGEST // 2]} … {text[-_LONGEST // 4 :]}"


class InputError(ValueError):
    """The input is not what it should be, and the user can mend it. User names and passwords of
    addresses are not shown.

    Parameters
    ----------
    problem : what was expected and what was found.
    where : file, option or frame that the problem is in ("det.txt, line 12").
    cure : what to do about it; may be empty.
    """

    def __init__(self, problem: str, *, where: str | Path = "", cure: str = "") -> None:
        self.problem = _sentence(problem)
        self.where = _sentence(str(where))
        self.cure = _sentence(cure)
        if self.where:
            text = f"{self.where}: {self.problem}"
        else:
            text = self.problem
        super().__init__(f"{text.rstrip('.')}. {self.cure}" if cure else text)


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """The cure for a name that is not among the ``known``: the nearest of them, or all."""
    names = list(known)
    close = difflib.get_close_matches(name, names, 1)
    if close:
        return f"Did you mean {close[0]}?"
    return f"There are {', '.join(names) or 'none'}."


def needed(module: str) -> Any:
    """The module, of a package that need not be installed with this one; `InputError` says what to
    install.
    """
    try:
        return import_module(module)
    except ImportError as error:
        raise absent(error, module) from None


def absent(error: ImportError, module: str = "") -> InputError:
    """What to install where a ``module``, or one that it needs, is missing. Raises ``error`` where
    that is not known.
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
    """Whether ``error`` is Ctrl-C, or what compiled code has made of it: some of Numba's turns it
    into a SystemError.
    """
    seen: BaseException | None = error
    while seen is not None:
        if isinstance(seen, KeyboardInterrupt):
            return True
        seen = seen.__cause__ or seen.__context__
    return False


@cache
def bounds(kind: type[Any]) -> tuple[tuple[str, tuple[Any, ...]], ...]:
    """Pairs (field, its bounds) of a dataclass whose annotations state any."""
    hints = get_type_hints(kind, include_extras=True)
    found = []
    for field in fields(kind):
        hint = hints[field.name]
        # Of a tuple all elements have the bounds of the first.
        if get_origin(hint) is tuple:
            hint = get_args(hint)[0]
        else:
            hint = hint
        if get_origin(hint) is Annotated:
            found.append((field.name, get_args(hint)[1:]))
    return tuple(found)


class Checked:
    """A dataclass whose fields are within the bounds of their annotations."""

    __slots__ = ()

    def __post_init__(self) -> None:
        check(self)


def check(settings: Any) -> None:
    """Raise `InputError` where a field of the dataclass ``settings`` breaks its annotation's bounds
    or is not finite.
    """
    kind: Any = type(settings)
    for name, limits in bounds(kind):
        given = getattr(settings, name)
        for value in given if isinstance(given, tuple) else (given,):
            _check_number(value, limits, f"{kind.__name__}.{name}")


def _check_number(value: Any, limits: tuple[Any, ...], where: str) -> None:
    """Raise `InputError` where the value is no finite number within the limits."""
    if isinstance(value, bool) or not isinstance(value, Real):
        raise InputError(f"expected a number, got {value!r}", where=where)
    if not math.isfinite(value):
        raise InputError(f"expected a number that is finite, got {value:g}", where=where)
    for limit in limits:
        words, attribute = _TESTS[type(limit)]
        bound = getattr(limit, attribute)
        if not getattr(operator, attribute)(value, bound):
            raise InputError(f"expected a value {words} {bound:g}, got {value:g}", where=where)
