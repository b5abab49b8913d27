"""``python -m phdtrack.compile_apart FOLDER SHARED``: the second process of `second_compiler`.

It compiles kernels for the settings of a tracker that another process has begun to compile for.
"""

from __future__ import annotations

import inspect
import os
import pickle
import shutil
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import update_wrapper
from io import BytesIO
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numba import types

from phdtrack.kernels import cache
from phdtrack.kernels.second_compiler import FINISHED, NOW, SETTINGS

# The packages whose classes settings may have, and the built-in classes. The modules of a user's
# program are not imported: they may do more than define classes.
_KNOWN = {"collections", "datetime", "functools", "numpy", "pathlib", "phdtrack"}
_BUILT_IN = {"bytearray", "complex", "frozenset", "range", "set", "slice"}
# Boxes of the first updates, and their motion: their calls are known after a few frames.
_BOXES = np.array([[100.0, 100, 140, 200], [300, 200, 350, 320], [500, 90, 540, 190]])
_MOTION = np.array([4.0, 2, 4, 2])
_FRAMES = 5
# Seconds without compilation after which it pays to compile what is known: particles take longer.
_LONGEST = 5.0


class _Interpreted:
    """A kernel that is run without compilation, and the types with which Python has called it."""

    _depth = 0

    def __init__(self, function: Callable[..., Any], options: dict[str, Any]) -> None:
        self.function = function
        self.options = options
        self.types = dict[tuple[Any, ...], None]()
        self._signature = inspect.signature(function)
        update_wrapper(self, function)

    def __call__(self, *args: Any, **named: Any) -> Any:
        """Run the function; note the types if it is not called by another kernel."""
        if _Interpreted._depth == 0:
            with suppress(TypeError, ValueError):
                self.types.setdefault(self._types_of(args, named))
                _CALLED.setdefault(self)
        _Interpreted._depth += 1
        try:
            return self.function(*args, **named)
        finally:
            _Interpreted._depth -= 1

    def _types_of(self, args: tuple[Any, ...], named: dict[str, Any]) -> tuple[Any, ...]:
        """Numba's types of all arguments, as a compiled kernel would see them."""
        given = self._signature.bind(*args, **named).arguments
        return tuple(
            numba.typeof(given[name]) if name in given else types.Omitted(parameter.default)
            for name, parameter in self._signature.parameters.items()
        )

    @property
    def name(self) -> str:
        """The beginning of the names of its files."""
        return f"{self.function.__module__.rpartition('.')[2]}.{self.function.__qualname__}"


# The kernels that Python has called, in the order of their first call.
_CALLED = dict[_Interpreted, None]()


class SettingsReader(pickle.Unpickler):
    """Reads settings, which only the first process can have written, without importing anything of
    the user's.
    """

    def find_class(self, module: str, name: str) -> Any:
        """The class of this name, if its package is known.

        Raises `pickle.UnpicklingError` if it is not.
        """
        known = name in _BUILT_IN if module == "builtins" else module.partition(".")[0] in _KNOWN
        if not known:
            raise pickle.UnpicklingError(f"{module}.{name} is no class of settings")
        return super().find_class(module, name)


def main(folder: Path, shared: Path) -> None:
    """Compile kernels, beginning with the last ones that a tracker's first updates call.

    Parameters
    ----------
    folder : where the other process keeps kernels.
    shared : what both exchange; see `second_compiler`.
    """
    # Numba would turn Ctrl-C into an error of the kernel.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    threading.Thread(target=_end_with_parent, args=(shared,), daemon=True).start()
    for kernel, compiled in _in_order((shared / SETTINGS).read_bytes()):
        made = any(folder.glob(f"{kernel.name}-*.nbi"))
        if made or _read(shared / NOW) == kernel.name:
            continue
        with suppress(Exception):
            for signature in kernel.types:
                compiled.compile(signature)
            _hand_over(kernel.name, Path(compiled.stats.cache_path), shared / FINISHED)


def _end_with_parent(shared: Path) -> None:
    """End this process when the input ends, because the other process has ended."""
    # Not by way of sys.stdin, whose lock the end of the interpreter would wait for.
    while os.read(0, 4096):
        pass
    shutil.rmtree(shared, ignore_errors=True)
    os._exit(0)


def _in_order(settings: bytes) -> Iterator[tuple[_Interpreted, Any]]:
    """The kernels that a tracker with these settings calls, each with its form that is compiled:
    first those of the first updates, then the others; backwards, as the other process compiles
    them in the order of the calls.
    """
    cache.njit = lambda **options: lambda function: _Interpreted(function, options)
    cache.INTERPRETED = True
    # What imports kernels comes after this.
    from phdtrack.tracker import Tracker

    classes, seed = SettingsReader(BytesIO(settings)).load()
    tracker = Tracker(stages=classes, seed=seed)
    tracker.on_warning = lambda sentence: None
    began = time.monotonic()
    for k in range(_FRAMES):
        tracker.update(_BOXES + k * _MOTION)
    first = list(_CALLED)
    if time.monotonic() - began < _LONGEST:
        tracker.warm_up()
    others = list(_CALLED)[len(first) :]
    forms = _compiled_forms()
    for kernel in (*reversed(first), *reversed(others)):
        yield kernel, forms[kernel]


def _compiled_forms() -> dict[_Interpreted, Any]:
    """All kernels in the form that Numba compiles, which takes their place in the modules."""
    forms = dict[_Interpreted, Any]()
    for name, module in list(sys.modules.items()):
        if not name.startswith("phdtrack."):
            continue
        for attribute, value in list(vars(module).items()):
            if isinstance(value, _Interpreted):
                if value not in forms:
                    forms[value] = numba.njit(**value.options)(value.function)
                setattr(module, attribute, forms[value])
    return forms


def _hand_over(name: str, kept: Path, finished: Path) -> None:
    """Move a kernel's files to those that are finished. The list of its forms comes last, because
    the other process looks for it.
    """
    for pattern in ("nbc", "nbi"):
        for file in kept.glob(f"{name}-*.{pattern}"):
            file.replace(finished / file.name)


def _read(file: Path) -> str:
    """The content of a text file; empty if there is none."""
    with suppress(OSError):
        return file.read_text()
    return ""


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
