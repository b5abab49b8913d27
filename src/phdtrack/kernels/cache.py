"""Where compiled kernels are kept between runs, and that what is kept there is what the sources
say.

Numba keeps them in the first folder that it can write into: ``$NUMBA_CACHE_DIR``, ``__pycache__``
beside the sources, the user's own cache. To that is added here:

* Where it can write into none, a folder is made that lives as long as the process.
* Numba compiles a kernel anew only where the file of that kernel changes, not of those that it
  calls. So the folder carries a digest of all sources, and is emptied where that is another one.
* A kernel compiled for a record of the user's program is not kept: another program could not read
  the list of kernels then.
"""

from __future__ import annotations

import atexit
import gc
import hashlib
import logging
import os
import shutil
import tempfile
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numba
from numba.core import codegen, event

_LOG = logging.getLogger(__name__)
_COMPILING = (
    "phdtrack compiles its kernels (ten seconds or more, once on this machine: they are kept for"
    " the next runs) ..."
)
_ALWAYS_COMPILING = (
    "phdtrack compiles its kernels (ten seconds or more, and so in every run: neither the"
    " installation nor the home folder can be written into; set NUMBA_CACHE_DIR to a folder that"
    " can) ..."
)
SOURCES = Path(__file__).parent


def njit(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """``numba.njit`` for kernels of this package; with ``cache=True`` kernels of records from
    outside are not kept.
    """

    def compiled(function: Callable[..., Any]) -> Any:
        dispatcher: Any = numba.njit(**options)(function)
        if numba.config.DISABLE_JIT:
            return dispatcher
        # What vectorises does so where it is optimised by itself.
        dispatcher.compile = _compiling(
            dispatcher.compile, "no_cpython_wrapper" in options, "fastmath" in options
        )
        if not options.get("cache"):
            return dispatcher
        keep = dispatcher._cache.save_overload

        def keep_own(signature: Any, data: Any) -> None:
            if not any(_from_outside(kind) for kind in data.signature.args):
                keep(signature, data)

        dispatcher._cache.save_overload = keep_own
        return dispatcher

    return compiled


def _compiling(compile_for: Callable[..., Any], inner: bool, vector: bool) -> Callable[..., Any]:
    """The same, faster: without a search for garbage, of which Numba makes hardly any.

    An ``inner`` function, which only kernels call, is a part of each of them and gets no machine
    code of its own: a kernel would run that instead of its own part in the process that compiles,
    and round otherwise than where it is loaded. Unless ``vector``, it is not optimised by itself
    either. The two save an eighth of the time.
    """

    def compiled(*signature: Any) -> Any:
        searched = gc.isenabled()
        before = _now.__dict__.copy()
        gc.disable()
        _now.inner = inner
        _now.plain = inner and not vector
        try:
            return compile_for(*signature)
        finally:
            _now.__dict__.update({"inner": False, "plain": False} | before)
            if searched:
                gc.enable()

    return compiled


def _leave_out(kind: Any, step: str, where: str, instead: Callable[[Any], None]) -> None:
    """Let Numba do something else than a ``step`` of its compilation ``where`` it is so; a Numba
    built otherwise does it.
    """
    done: Any = getattr(kind, step, None)

    def do(library: Any, *rest: Any) -> None:
        if getattr(_now, where, False):
            instead(library)
        else:
            done(library, *rest)

    if done is not None:
        setattr(kind, step, do)


_now = threading.local()
_leave_out(codegen.CPUCodeLibrary, "_optimize_final_module", "plain", lambda library: None)
_leave_out(
    codegen.CPUCodeLibrary,
    "_finalize_final_module",
    "inner",
    lambda library: setattr(library, "_finalized", True),
)
_leave_out(codegen.JITCPUCodegen, "set_env", "inner", lambda library: None)


def _from_outside(kind: Any) -> bool:
    """Whether an argument's type is, or holds, a record that is not of this package."""
    record = getattr(kind, "instance_class", None)
    foreign = record is not None and not record.__module__.startswith(
        __name__.partition(".")[0] + "."
    )
    return foreign or any(_from_outside(part) for part in getattr(kind, "types", ()))


# Numba has no types.
class _Announcement(event.Listener):  # type: ignore[misc]
    """Says once, on a logger below ``phdtrack``, that a kernel of ours is compiled, and not where
    one is loaded.
    """

    def __init__(self, sentence: str) -> None:
        self._sentence = sentence

    def on_start(self, event: event.Event) -> None:
        """A function begins to be compiled."""
        if self._sentence and event.data["dispatcher"].py_func.__module__.startswith("phdtrack."):
            _LOG.warning(self._sentence)
            self._sentence = ""

    def on_end(self, event: event.Event) -> None:
        """Nothing."""


def prepare() -> None:
    """Find the folder as Numba will, make one where there is none, empty it where it is of other
    sources; let it be said when kernels are compiled."""
    if numba.config.DISABLE_JIT:
        return
    lasting = True
    try:
        folder = _numbas_folder()
    except RuntimeError:
        lasting = False
        numba.config.CACHE_DIR = tempfile.mkdtemp(prefix="phdtrack-kernels-")
        atexit.register(shutil.rmtree, numba.config.CACHE_DIR, ignore_errors=True)
        folder = _numbas_folder()
    event.register("numba:compile", _Announcement(_COMPILING if lasting else _ALWAYS_COMPILING))
    total = hashlib.sha256()
    for file in sorted(SOURCES.glob("*.py")):
        total.update(file.name.encode() + hashlib.sha256(file.read_bytes()).digest())
    stamp = folder / "phdtrack-kernels.sha256"
    now = total.hexdigest()
    with suppress(OSError):
        if stamp.read_text() == now:
            return
    for index in folder.glob("*.nb[ic]"):
        # Another process may be doing the same.
        index.unlink(missing_ok=True)
    stamp.write_text(now)


def _numbas_folder() -> Path:
    """The folder that Numba takes for functions of this package; RuntimeError where it finds
    none.
    """
    if os.path.expanduser("~") == "~" and not (
        numba.config.CACHE_DIR or os.access(SOURCES, os.W_OK)
    ):
        # A user without a home folder: Numba would make a folder called "~" where the process
        # happens to be.
        raise RuntimeError("no home")
    # Defined, never compiled: it is enough to learn the folder.
    probe: Any = njit(cache=True)(_from_outside)
    return Path(probe.stats.cache_path)
