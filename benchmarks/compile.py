"""Measure how long `phdtrack track` compiles with an empty cache, and how soon it tracks with a
full one.

    python -m benchmarks.compile

Both are measured in processes of their own, on a small made-up file of detections.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numba.core import event

from phdtrack.kernels.second_compiler import PROCESSES

# What the process says of itself; the clock of the parent tells when it was started.
PROGRAM = """
import json, sys, time
from benchmarks.compile import watched
from phdtrack.tracker import Tracker

report, path, update = {}, sys.argv.pop(1), Tracker.update

def first(self, *frame):
    rows = update(self, *frame)
    report.setdefault("first_frame", time.time())
    return rows

Tracker.update = first
from phdtrack.cli.app import main
with watched() as kernels:
    try:
        main()
    finally:
        json.dump(report | {"kernels": kernels}, open(path, "w"))
"""


# Numba has no types.
class _Listener(event.Listener):  # type: ignore[misc]
    """Adds up seconds of processor time. Numba compiles one function at a time, and those that it
    calls in between.
    """

    def __init__(self) -> None:
        self.kernels: dict[str, float] = {}
        self._stack: list[list[float]] = []

    def on_start(self, event: event.Event) -> None:
        """A function begins to be compiled: when, and the seconds of kernels compiled on its
        behalf.
        """
        self._stack.append([time.thread_time(), 0.0])

    def on_end(self, event: event.Event) -> None:
        """It has been compiled. Parts of Numba itself that a kernel uses count as the kernel's."""
        function = event.data["dispatcher"].py_func
        clock, within = self._stack.pop()
        passed = time.thread_time() - clock
        ours = function.__module__.startswith("phdtrack.")
        if ours:
            self.kernels[function.__name__] = (
                self.kernels.get(function.__name__, 0.0) + passed - within
            )
        if self._stack:
            self._stack[-1][1] += passed if ours else within


@contextmanager
def watched() -> Iterator[dict[str, float]]:
    """Seconds of processor time by name of kernel, filled while this lasts; each without the
    kernels that it calls.
    """
    listener = _Listener()
    with event.install_listener("numba:compile", listener):
        yield listener.kernels


def measure(starts: int = 5) -> dict[str, Any]:
    """Measure what a first run compiles, and the time from start to first tracked frame.

    ``compile_s``: processor time of all that is compiled, ``kernels``: of each, in a single
    process; ``first_use_s`` to the first frame in a first run that may compile in two;
    ``start_s`` in the fastest of ``starts`` runs after it.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        detections(folder / "det.txt")
        alone = _run(folder, "alone", {PROCESSES: "1"})
        first = _run(folder)
        later = [_run(folder) for _ in range(starts)]
    start = min(run["start"] for run in later)
    return {
        "compile_s": sum(alone["kernels"].values()),
        "kernels": alone["kernels"],
        "first_use_s": first["start"],
        "start_s": start,
    }


def detections(path: Path, frames: int = 40, objects: int = 5, seed: int = 1) -> None:
    """A MOTChallenge file of objects that walk through a frame of 640x480, with jitter, misses and
    clutter.
    """
    rng = np.random.default_rng(seed)
    place = rng.uniform((50, 50), (500, 350), (objects, 2))
    speed = rng.normal(0, 2, (objects, 2))
    rows = []
    for number in range(1, frames + 1):
        place = place + speed
        seen = place[rng.random(objects) < 0.95] + rng.normal(0, 1, (1, 2))
        for left, top in np.vstack([seen, rng.uniform((0, 0), (600, 400), (2, 2))]):
            rows.append(f"{number},-1,{left:.2f},{top:.2f},24,60,1,-1,-1,-1")
    path.write_text("\n".join(rows) + "\n")


def _run(
    folder: Path, kept: str = "cache", variables: Mapping[str, str] = MappingProxyType({})
) -> dict[str, Any]:
    """One process, with a cache of its own in ``folder``, and these variables of the
    environment.
    """
    options = [
        "track",
        "--detections",
        str(folder / "det.txt"),
        "--frame-size",
        "640x480",
        "--fps",
        "25",
    ]
    out = ["--out", str(folder / "run"), "--overwrite"]
    # Bytecode is kept, as an installation has it, also where the shell forbids it: that work is no
    # part of a start.
    environment = os.environ | {
        "NUMBA_CACHE_DIR": str(folder / kept),
        "PYTHONDONTWRITEBYTECODE": "",
        **variables,
    }
    began = time.time()
    command = [sys.executable, "-c", PROGRAM, str(folder / "report.json"), *options, *out]
    subprocess.run(command, check=True, env=environment, stdout=subprocess.DEVNULL)
    report: dict[str, Any] = json.loads((folder / "report.json").read_text())
    return report | {"start": report["first_frame"] - began}


def main() -> None:
    """Print what was measured."""
    found = measure()
    for name, seconds in sorted(found["kernels"].items(), key=lambda pair: -pair[1]):
        print(f"{seconds:8.2f} s  {name}")
    print(
        f"{found['compile_s']:8.2f} s  these {len(found['kernels'])}, each without those that it"
        " calls"
    )
    print(
        f"first frame after {found['first_use_s']:.1f} s on first use, {found['start_s']:.2f} s"
        " from then on"
    )


if __name__ == "__main__":
    main()
