"""Compiling on first use with all cores: which kernels a run will call is known beforehand, so processes can share them out.

``kernels.json`` lists them, in the order of their first call, as a run on a small scene called them
(``scripts/called_kernels.py`` writes it, a test compares). Nothing depends on the list: what it lacks is compiled where
it is called, and so is what a process could not do.
"""

from __future__ import annotations

import gc
import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numba
from numba.core import sigutils, types
from numba.core.registry import CPUDispatcher

from phdtrack.kernels import CACHE

TABLE = Path(__file__).with_name("kernels.json")
KERNELS = "phdtrack.kernels."
MOST = 8
WORTH = 3.0
"""Seconds of compiling that are worth a process of their own: its start takes half a second."""
# The interpreter finds its modules where this one does; nothing is imported from the script that the user runs.
PROGRAM = (
    "import sys; sys.path[:] = sys.argv[2].split('\\n'); "
    "from phdtrack.cli.precompile import compile_numbered; compile_numbered(sys.argv[1])"
)


@dataclass(frozen=True, slots=True)
class Called:
    """A kernel as a run calls it.

    ``name``: ``module.function`` in `phdtrack.kernels`; ``types``: of its arguments, in Numba's notation; ``seconds``: what
    it took to compile it on some machine, which only decides how the work is shared out; ``filters``: by names, whose
    runs call it.
    """

    name: str
    types: str
    seconds: float
    filters: tuple[str, ...]


def table() -> tuple[Called, ...]:
    """All that is known, in the order of the first call."""
    rows = json.loads(TABLE.read_text())
    return tuple(Called(row["name"], row["types"], row["seconds"], tuple(row["filters"])) for row in rows)


def precompile(filter_name: str) -> None:
    """Compile what a run with this filter will call, unless it is on disk, in as many processes as there are cores.

    Whatever ends this call ends the processes too.
    """
    if numba.config.DISABLE_JIT:
        return
    known = table()
    kept = {index.name.rpartition("-")[0] for index in CACHE.folder.glob("*.nbi")}
    wanted = [number for number, row in enumerate(known) if filter_name in row.filters and row.name not in kept]
    cost = [known[number].seconds for number in wanted]
    processes = min(_cores(), MOST, int(sum(cost) / WORTH)) if _can_start() else 1
    own, *others = shares(wanted, cost, max(processes, 1))
    children: list[subprocess.Popen[bytes]] = []
    try:
        children.extend(_started(share) for share in others)
        _compile(known, own)
        for child in children:
            child.wait()
    finally:
        for child in children:
            child.terminate()
        for child in children:
            child.wait()


def shares(items: Sequence[int], cost: Sequence[float], count: int) -> list[list[int]]:
    """``items`` in ``count`` stretches of about equal cost; neighbours stay together, because they call the same helpers."""
    stretches: list[list[int]] = [[] for _ in range(count)]
    total, before = sum(cost), 0.0
    for item, seconds in zip(items, cost, strict=True):
        stretches[min(int((before + seconds / 2) / total * count), count - 1)].append(item)
        before += seconds
    return stretches


def compile_numbered(numbers: str) -> None:
    """A child's work: rows of the table, by comma-separated numbers. What it leaves on disk is what counts."""
    _compile(table(), [int(number) for number in numbers.split(",")] if numbers else [])


def called() -> Iterator[tuple[str, str]]:
    """Kernels compiled or loaded in this process, ``module.function``, and their types, where these can be written.

    In a process that found everything on disk these are the kernels that were called from Python: what they call comes
    with them.
    """
    for name, module in sorted(sys.modules.items()):
        if name.startswith(KERNELS):
            for function, kernel in vars(module).items():
                if isinstance(kernel, CPUDispatcher) and kernel.py_func.__module__ == name:
                    for arguments in kernel.signatures:
                        if all(_writable(argument) for argument in arguments):
                            written = ", ".join(_written(argument) for argument in arguments)
                            yield f"{name.removeprefix(KERNELS)}.{function}", f"({written},)"


def _compile(known: Sequence[Called], numbers: Sequence[int]) -> None:
    """These rows of the table, into the cache on disk."""
    with _no_collecting():
        for number in numbers:
            module, _, function = known[number].name.rpartition(".")
            try:
                kernel: Any = getattr(import_module(KERNELS + module), function)
                arguments, _ = sigutils.normalize_signature(known[number].types)
                # The tuple is what Numba's index is asked for when the kernel is called; a text would be another key.
                with _interrupted_afterwards():
                    kernel.compile(arguments)
            except Exception:
                # An older table, a full disk: the run compiles it where it is called, and says there what is wrong.
                continue


@contextmanager
def _no_collecting() -> Iterator[None]:
    """While this lasts, nobody looks for garbage: compiling makes millions of objects, and the looks take a tenth of it."""
    collecting = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collecting:
            gc.enable()


@contextmanager
def _interrupted_afterwards() -> Iterator[None]:
    """Ctrl-C while this lasts comes at its end: LLVM calls Python back now and then, and what is raised there is lost."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    noted: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, frame: noted.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.SIG_DFL if before is None else before)
    if noted:
        signal.raise_signal(signal.SIGINT)


def _started(share: Sequence[int]) -> subprocess.Popen[bytes]:
    """A child on its way. It shares this process's cache, also where that is a temporary one."""
    folder = {"NUMBA_CACHE_DIR": numba.config.CACHE_DIR} if numba.config.CACHE_DIR else {}
    nothing = subprocess.DEVNULL
    arguments = [sys.executable, "-c", PROGRAM, ",".join(map(str, share)), "\n".join(sys.path)]
    return subprocess.Popen(arguments, env=os.environ | folder, stdin=nothing, stdout=nothing, stderr=nothing)


def _can_start() -> bool:
    """Whether there is an interpreter to start: in a frozen application ``sys.executable`` is the application itself."""
    return bool(sys.executable) and not getattr(sys, "frozen", False)


def _cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1


def _writable(kind: Any) -> bool:
    """Numbers, truth values and arrays of these that may be written into."""
    if isinstance(kind, types.Array):
        return bool(kind.mutable and kind.aligned and isinstance(kind.dtype, types.Number | types.Boolean))
    return isinstance(kind, types.Number | types.Boolean) and not isinstance(kind, types.Literal)


def _written(kind: Any) -> str:
    """A type in the notation that signatures are written in."""
    if not isinstance(kind, types.Array):
        return "boolean" if isinstance(kind, types.Boolean) else str(kind)
    axes = [":"] * kind.ndim
    if kind.layout in "CF":
        axes[-1 if kind.layout == "C" else 0] = "::1"
    return f"{_written(kind.dtype)}[{','.join(axes)}]"
