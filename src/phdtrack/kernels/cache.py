"""The folder in which compiled kernels are kept between runs.

Numba keeps them in the first folder that it can write into: ``$NUMBA_CACHE_DIR``, ``__pycache__``
beside the sources, the user's own cache. Two things are added:

* If it can write into none, a folder is made that lives as long as the process.
* Numba compiles a kernel anew only if the file of that kernel has changed, not the files of the
  functions that it calls. So the folder carries a digest for each file, of its text and of all
  that it imports from this package, and the kernels of a file are removed if that changes.
"""

from __future__ import annotations

import atexit
import gc
import hashlib
import logging
import os
import re
import shutil
import tempfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numba
from numba.core import event

from phdtrack.kernels.second_compiler import SECOND

_LOG = logging.getLogger(__name__)
_COMPILING = (
    "phdtrack compiles its kernels, in half a minute or more, and keeps them for the next runs on"
    " this machine. What is first used later, such as corrected tracks, is compiled then. `phdtrack"
    " warm-up`, or warm_up() of a Tracker, compiles all before the first frame ..."
)
_ALWAYS_COMPILING = (
    "phdtrack compiles its kernels (half a minute or more, and so in every run: neither the"
    " installation nor the home folder can be written into; set NUMBA_CACHE_DIR to a folder that"
    " can) ..."
)
SOURCES = Path(__file__).parent
# What a file of kernels says of those that it imports.
_IMPORTS = re.compile(rb"^from phdtrack\.kernels\.(\w+) import", re.MULTILINE)
# The folder that lives as long as the process, if there is one.
_TEMPORARY = list[str]()


njit: Callable[..., Callable[[Callable[..., Any]], Any]] = numba.njit
# True in a process that runs kernels without compilation, to learn the types of their arguments.
INTERPRETED = False


# Numba has no types.
class _Compilations(event.Listener):  # type: ignore[misc]
    """Announces, once, that kernels of this package are being compiled; not if they are loaded.
    Shares the work with a second process.

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
        function = event.data["dispatcher"].py_func
        if not function.__module__.startswith("phdtrack."):
            return
        if self._sentence:
            _LOG.warning(self._sentence)
            self._sentence = ""
        if self._depth == 1:
            SECOND.compiling(f"{function.__module__.rpartition('.')[2]}.{function.__qualname__}")

    def on_end(self, event: event.Event) -> None:
        """A function has been compiled, or failed to be."""
        self._depth -= 1
        if self._depth == 0:
            SECOND.compiled()
            if self._collecting:
                gc.enable()


def prepare() -> None:
    """Find the folder as Numba does, make one if there is none, remove kernels of other sources
    from it; announce when kernels are compiled.
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
    _remove_outdated(folder, _digests())
    SECOND.prepare(folder)


def _digests() -> dict[str, str]:
    """A digest of each file of kernels, and of all those that it imports."""
    text = {file.stem: file.read_bytes() for file in SOURCES.glob("*.py")}
    imports = {name: {found.decode() for found in _IMPORTS.findall(text[name])} for name in text}
    single = {name: hashlib.sha256(text[name]).digest() for name in text}
    digests = {}
    for name in text:
        # Python runs the package's own file before any other.
        needed = {name, "__init__"}
        waiting = list(needed)
        while waiting:
            more = imports[waiting.pop()] & text.keys() - needed
            needed |= more
            waiting += more
        total = hashlib.sha256()
        for other in sorted(needed):
            total.update(other.encode() + single[other])
        digests[name] = total.hexdigest()
    return digests


def _remove_outdated(folder: Path, digests: dict[str, str]) -> None:
    """Remove kernels from the folder whose file had another digest, or none, when they were kept,
    and write the ``digests`` of now.
    """
    stamp = folder / "phdtrack-kernels.sha256"
    now = "".join(f"{digests[name]}  {name}\n" for name in sorted(digests))
    before = ""
    with suppress(OSError):
        before = stamp.read_text()
    if before == now:
        return
    known = set(before.splitlines())
    current = {name for name in digests if f"{digests[name]}  {name}" in known}
    for kept in folder.glob("*.nb[ic]"):
        # Numba's names begin with that of the file.
        if kept.name.partition(".")[0] not in current:
            # Another process may be doing the same.
            kept.unlink(missing_ok=True)
    stamp.write_text(now)


def without_compilation() -> bool:
    """True if kernels are run as Python."""
    return INTERPRETED or bool(numba.config.DISABLE_JIT)


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
    probe: Any = numba.njit(cache=True)(_numbas_folder)
    return Path(probe.stats.cache_path)
