"""A second process that compiles kernels while this one compiles others.

If few kernels are kept and there are two cores, the first compilation starts
``python -m phdtrack.compile_apart``. It runs the same settings on made-up boxes without compiled
code, which shows the types of all arguments, and then compiles from the last kernel backwards, into
a folder of its own. Whenever this process has compiled a kernel, it takes over the ones that are
finished there. So both processes meet in the middle, and Numba's lists of kept kernels are only
written by this one.

Nothing depends on the second process: without it, or if it fails, compilation takes longer.
"""

from __future__ import annotations

import atexit
import glob
import multiprocessing
import os
import shutil
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable
from contextlib import suppress
from itertools import islice
from pathlib import Path

from numba.core.compiler_lock import global_compiler_lock

# With 1 in this variable of the environment, a process compiles alone.
PROCESSES = "PHDTRACK_COMPILE_PROCESSES"
# What the two processes exchange, in a folder: the settings, the name of the kernel that the first
# one compiles, and the kernels that the second one has finished.
SETTINGS, NOW, FINISHED = "settings", "now", "finished"
# If fewer kernels are kept, most are still to be compiled; the usual settings need about 30.
_FEW = 20
# Seconds that the end of the program waits for the second process to end.
_PATIENCE = 5.0


class SecondCompiler:
    """The second process of this one, if there is one."""

    def __init__(self) -> None:
        # Where kernels are kept; None if no process is to be started, any more.
        self._folder: Path | None = None
        self._settings: Callable[[], bytes] | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self._target = self._shared = Path()
        self._owner = 0

    def prepare(self, folder: Path) -> None:
        """Allow a process if few kernels are kept in the ``folder``, and there is a core for it."""
        if len(list(islice(folder.glob("*.nbi"), _FEW))) < _FEW and _possible():
            self._folder = folder

    def offer(self, settings: Callable[[], bytes]) -> None:
        """Set what the process is to be given when it starts, for `compile_apart`."""
        if self._folder is not None:
            self._settings = settings

    def compiling(self, name: str) -> None:
        """Start the process if this is due, and note the kernel that this process compiles."""
        with suppress(Exception):
            if self._folder is not None and self._settings is not None:
                folder, settings = self._folder, self._settings
                self._folder = self._settings = None
                self._start(folder, settings)
            if self._running:
                (self._shared / NOW).write_text(name)

    def compiled(self) -> None:
        """Take over what the process has finished. Numba's lock is held."""
        if self._running:
            self._take_over()

    @property
    def _running(self) -> bool:
        """True while there is a process, except in a copy of this one that a fork has made."""
        return self._process is not None and self._owner == os.getpid()

    def _start(self, folder: Path, settings: Callable[[], bytes]) -> None:
        """Start the process. It ends with this one, when its input ends."""
        content = settings()
        shared = Path(tempfile.mkdtemp(prefix="phdtrack-compiler-"))
        try:
            (shared / FINISHED).mkdir()
            (shared / SETTINGS).write_bytes(content)
            path = os.pathsep.join(entry for entry in sys.path if entry)
            environment = os.environ | {
                "PYTHONPATH": path,
                "NUMBA_CACHE_DIR": str(shared),
                PROCESSES: "1",
            }
            process = subprocess.Popen(
                [sys.executable, "-P", "-m", "phdtrack.compile_apart", str(folder), str(shared)],
                env=environment,
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                # Windows opens no console for it.
                creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
            )
        except BaseException:
            shutil.rmtree(shared, ignore_errors=True)
            raise
        self._target, self._shared, self._owner = folder, shared, os.getpid()
        self._process = process
        waiting = threading.Thread(
            target=self._finish, args=(process,), name="phdtrack compiler", daemon=True
        )
        waiting.start()
        atexit.register(self._end, process, waiting)

    def _finish(self, process: subprocess.Popen[bytes]) -> None:
        """Wait for the process to end, take the rest over, and remove what was exchanged."""
        process.wait()
        with global_compiler_lock:
            self._take_over()
            self._process = None
        if process.stdin is not None:
            process.stdin.close()
        shutil.rmtree(self._shared, ignore_errors=True)

    def _end(self, process: subprocess.Popen[bytes], waiting: threading.Thread) -> None:
        """End the process at the end of the program."""
        if self._owner == os.getpid() and waiting.is_alive():
            process.kill()
            waiting.join(_PATIENCE)

    def _take_over(self) -> None:
        """Move finished kernels to where kernels are kept, unless this process has made them."""
        with suppress(OSError):
            for index in sorted((self._shared / FINISHED).glob("*.nbi")):
                if not (self._target / index.name).exists():
                    for code in index.parent.glob(f"{glob.escape(index.stem)}.*.nbc"):
                        _move(code, self._target)
                    # The list comes last: it names the files with the code.
                    _move(index, self._target)
                index.unlink(missing_ok=True)


def _move(file: Path, folder: Path) -> None:
    """Move a file into a folder, perhaps of another disk, where it appears at once and complete."""
    part = folder / f"{file.name}.tmp.{os.getpid()}"
    try:
        shutil.copyfile(file, part)
        part.replace(folder / file.name)
    except OSError:
        part.unlink(missing_ok=True)
        raise
    file.unlink()


def _possible() -> bool:
    """True if this interpreter can start another one, and there is a core for it.

    Programs that are frozen or contain Python would start themselves. Of the processes of a pool
    each may compile already.
    """
    return (
        os.environ.get(PROCESSES) != "1"
        and _cores() > 1
        and multiprocessing.parent_process() is None
        and not getattr(sys, "frozen", False)
        and Path(sys.executable or "").name.lower().startswith("python")
    )


def _cores() -> int:
    """The number of cores that this process may use."""
    # Not on all systems.
    affinity = getattr(os, "sched_getaffinity", None)
    if affinity is not None:
        return len(affinity(0))
    return os.cpu_count() or 1


SECOND = SecondCompiler()
