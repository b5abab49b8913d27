"""The folder in which compiled kernels are kept between runs.

Numba keeps them in the first folder that it can write into: ``$NUMBA_CACHE_DIR``, ``__pycache__``
beside the sources, the user's own cache. Two things are added:

* If it can write into none, a folder is made that lives as long as the process.
* Numba compiles a kernel anew only if the file of that kernel has changed, not the files of the
  functions that it calls. So the folder carries a digest of all sources, and is emptied if that
  changes.
"""

from __future__ import annotations

import atexit
import gc
import hashlib
import logging
import os
import shutil
import tempfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numba
from numba.core import event

_LOG = logging.getLogger(__name__)
_COMPILING = (
    "phdtrack compiles its kernels (ten seconds or more, once on this machine: they are kept for"
    " the next runs; `phdtrack warm-up`, or warm_up() of a Tracker, does so before the first"
    " frame) ..."
)
_ALWAYS_COMPILING = (
    "phdtrack compiles its kernels (ten seconds or more, and so in every run: neither the"
    " installation nor the home folder can be written into; set NUMBA_CACHE_DIR to a folder that"
    " can) ..."
)
SOURCES = Path(__file__).parent
# The folder that lives as long as the process, if there is one.
_TEMPORARY = list[str]()


njit: Callable[..., Callable[[Callable[..., Any]], Any]] = numba.njit


# Numba has no types.
class _Compilations(event.Listener):  # type: ignore[misc]
    """Announces, once, that kernels of this package are being compiled; not if they are loaded.

    Garbage collection is paused meanwhile: Numba creates little garbage, and the search for it
    takes a tenth of the time.
    """

    def __init__(self, sentence: str) -> None:
        self._sentence = sentence
        self._depth = 0
        self._collecting = False

    def on_start(self, event: event.Event) -> None:
        """A function begins to be compiled, perhaps within another one."""
        if self._depth == 0:
            self._collecting = gc.isenabled()
            gc.disable()
        self._depth += 1
        if self._sentence and event.data["dispatcher"].py_func.__module__.startswith("phdtrack."):
            _LOG.warning(self._sentence)
            self._sentence = ""

    def on_end(self, event: event.Event) -> None:
        """A function has been compiled, or failed to be."""
        self._depth -= 1
        if self._depth == 0 and self._collecting:
            gc.enable()


def prepare() -> None:
    """Find the folder as Numba does, make one if there is none, empty it if its kernels are of
    other sources; announce when kernels are compiled.
    """
    if numba.config.DISABLE_JIT:
        return
    lasting = True
    try:
        folder = _numbas_folder()
    except RuntimeError:
        lasting = False
        numba.config.CACHE_DIR = tempfile.mkdtemp(prefix="phdtrack-kernels-")
        _TEMPORARY.append(numba.config.CACHE_DIR)
        atexit.register(shutil.rmtree, numba.config.CACHE_DIR, ignore_errors=True)
        folder = _numbas_folder()
    event.register("numba:compile", _Compilations(_COMPILING if lasting else _ALWAYS_COMPILING))
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


def are_kept() -> bool:
    """True if kernels of earlier processes are kept, so that they are loaded and not compiled."""
    if numba.config.DISABLE_JIT:
        return False
    return any(_numbas_folder().glob("*.nbi"))


def kept_in() -> Path | None:
    """The folder in which kernels are kept for later processes; None if they are not kept."""
    if numba.config.DISABLE_JIT or _TEMPORARY:
        return None
    return _numbas_folder()


def _numbas_folder() -> Path:
    """The folder that Numba uses for functions of this package. Raises `RuntimeError` if it finds
    none.
    """
    if os.path.expanduser("~") == "~" and not (
        numba.config.CACHE_DIR or os.access(SOURCES, os.W_OK)
    ):
        # A user without a home folder: Numba would make a folder called "~" where the process
        # happens to be.
        raise RuntimeError("no home")
    # Defined, never compiled: it is enough to learn the folder.
    probe: Any = njit(cache=True)(_numbas_folder)
    return Path(probe.stats.cache_path)
