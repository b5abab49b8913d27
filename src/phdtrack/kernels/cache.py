"""Where compiled kernels are kept between runs, and that what is kept there is what the sources say.

Numba looks for a folder when a kernel is defined: ``$NUMBA_CACHE_DIR``, ``__pycache__`` beside the sources, the user's own
cache, the first of them that can be written into. Two things it leaves to us:

* Where none can be written into (a read-only installation, a user without a home), it refuses to define the kernel. Then a
  folder is made that lives as long as the process.
* It keeps a kernel until the *file* of that kernel changes. A kernel that calls another one, of another file, would stay as
  it was compiled after an upgrade. So the folder carries a digest of all sources, and is emptied where that is another one.
* It also keeps a kernel compiled for a record of the user's program. Another program, which cannot import that record, could
  then not read the list of kept kernels. So `njit` keeps kernels of this package's own records only.
"""

from __future__ import annotations

import atexit
import gc
import hashlib
import os
import shutil
import tempfile
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numba
from numba.core import codegen

SOURCES = Path(__file__).parent
STAMP = "phdtrack-kernels.sha256"


@dataclass(frozen=True, slots=True)
class Cache:
    """``folder``: where compiled kernels are; ``lasting``: whether the next process finds them there."""

    folder: Path
    lasting: bool

    @property
    def kept(self) -> int:
        """How many kernels are there."""
        return len(list(self.folder.glob("*.nbi")))


def njit(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """``numba.njit`` for kernels of this package; with ``cache=True`` kernels of records from outside are not kept."""

    def compiled(function: Callable[..., Any]) -> Any:
        dispatcher: Any = numba.njit(**options)(function)
        if numba.config.DISABLE_JIT:
            return dispatcher
        # What vectorises does so where it is optimised by itself.
        inner = options.get("no_cpython_wrapper", False) and not options.get("fastmath")
        dispatcher.compile = _compiling(dispatcher.compile, inner)
        if not options.get("cache"):
            return dispatcher
        keep = dispatcher._cache.save_overload

        def keep_own(signature: Any, data: Any) -> None:
            if not any(_from_outside(kind) for kind in data.signature.args):
                keep(signature, data)

        dispatcher._cache.save_overload = keep_own
        return dispatcher

    return compiled


def _compiling(compile_for: Callable[..., Any], inner: bool) -> Callable[..., Any]:
    """The same, faster; ``inner`` says that only kernels call the function.

    Such a function is optimised in each kernel that calls it. Numba would optimise it by itself, too, which nobody sees and
    which takes an eighth of all the time to compile. And there is no search for garbage: Numba makes many objects and
    hardly any garbage.
    """

    def compiled(*signature: Any) -> Any:
        searched, before = gc.isenabled(), getattr(_now, "inner", False)
        gc.disable()
        _now.inner = inner
        try:
            return compile_for(*signature)
        finally:
            _now.inner = before
            if searched:
                gc.enable()

    return compiled


def _optimise_kernels_only() -> None:
    """Let Numba leave out the optimisation of what is compiled as ``inner``; a Numba built otherwise keeps it."""
    optimise: Any = getattr(codegen.CPUCodeLibrary, "_optimize_final_module", None)

    def optimised(library: Any) -> None:
        if not getattr(_now, "inner", False):
            optimise(library)

    if optimise is not None:
        codegen.CPUCodeLibrary._optimize_final_module = optimised


_now = threading.local()
_optimise_kernels_only()


def _from_outside(kind: Any) -> bool:
    """Whether an argument's type is, or holds, a record that is not of this package."""
    record = getattr(kind, "instance_class", None)
    foreign = record is not None and not record.__module__.startswith(__name__.partition(".")[0] + ".")
    return foreign or any(_from_outside(part) for part in getattr(kind, "types", ()))


def prepare() -> Cache:
    """Find the folder as Numba will, make one where there is none, empty it where it is of other sources."""
    if numba.config.DISABLE_JIT:
        return Cache(SOURCES / "__pycache__", lasting=True)
    try:
        folder = _somewhere()
    except RuntimeError:
        return _passing()
    _freshen(folder, digest(SOURCES))
    return Cache(folder, lasting=True)


def digest(sources: Path) -> str:
    """Of the names and contents of the Python files in a folder."""
    total = hashlib.sha256()
    for file in sorted(sources.glob("*.py")):
        total.update(file.name.encode() + hashlib.sha256(file.read_bytes()).digest())
    return total.hexdigest()


def _somewhere() -> Path:
    """The folder that Numba takes for functions of this package; RuntimeError where it finds none."""
    if os.path.expanduser("~") == "~" and not (numba.config.CACHE_DIR or os.access(SOURCES, os.W_OK)):
        # A user without a home folder: Numba would make a folder called "~" where the process happens to be.
        raise RuntimeError("no home")
    probe: Any = njit(cache=True)(_probe)
    return Path(probe.stats.cache_path)


def _probe() -> None:
    """Defined, never compiled: it is enough to learn the folder."""


def _passing() -> Cache:
    """A folder for this process."""
    folder = tempfile.mkdtemp(prefix="phdtrack-kernels-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    numba.config.CACHE_DIR = folder
    inside = _somewhere()
    # Processes that help to compile find the stamp, and do not empty the folder.
    _freshen(inside, digest(SOURCES))
    return Cache(inside, lasting=False)


def _freshen(folder: Path, now: str) -> None:
    """Empty ``folder`` where its kernels are not of the sources with the digest ``now``."""
    stamp = folder / STAMP
    with suppress(OSError):
        if stamp.read_text() == now:
            return
    for index in folder.glob("*.nb[ic]"):
        # Another process may be doing the same.
        index.unlink(missing_ok=True)
    stamp.write_text(now)
