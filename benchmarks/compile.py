"""First use and start: how long `phdtrack track` compiles with an empty cache, how soon it tracks with a full one.

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
from pathlib import Path
from typing import Any

import numpy as np

# What the process says of itself; the clock of the parent tells when it was started. Processes that helped to compile have
# ended by the time their processor time is asked for.
PROGRAM = """
import json, os, sys, time
from phdtrack.cli import steps
from phdtrack.cli.compiling import watched

report, path, advance = {}, sys.argv.pop(1), steps.Steps.advance

def first(self, *frame):
    step = advance(self, *frame)
    report.setdefault("first_frame", time.time())
    return step

steps.Steps.advance = first
from phdtrack.cli.app import main
with watched(lambda: None) as compiled:
    try:
        main()
    finally:
        times = os.times()
        report.update(seconds=compiled.seconds, kernels=compiled.kernels)
        report.update(helpers=times.children_user + times.children_system)
        json.dump(report, open(path, "w"))
"""


def measure(starts: int = 5) -> dict[str, Any]:
    """What a first run compiles, and how soon after its start a process has tracked its first frame.

    ``compile_s``: processor time of all that was compiled, helping processes with their start included, ``kernels``: of
    each that was compiled by the run's own process; ``first_use_s`` to the first frame in that run; ``start_s`` in the
    fastest of ``starts`` runs after it.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        detections(folder / "det.txt")
        first = _run(folder)
        later = [_run(folder) for _ in range(starts)]
    start = min(run["start"] for run in later)
    seconds = first["seconds"] + first["helpers"]
    return {"compile_s": seconds, "kernels": first["kernels"], "first_use_s": first["start"], "start_s": start}


def detections(path: Path, frames: int = 40, objects: int = 5, seed: int = 1) -> None:
    """A MOTChallenge file of objects that walk through a frame of 640x480, with jitter, misses and clutter."""
    rng = np.random.default_rng(seed)
    place, speed = rng.uniform((50, 50), (500, 350), (objects, 2)), rng.normal(0, 2, (objects, 2))
    rows = []
    for number in range(1, frames + 1):
        place = place + speed
        seen = place[rng.random(objects) < 0.95] + rng.normal(0, 1, (1, 2))
        for left, top in np.vstack([seen, rng.uniform((0, 0), (600, 400), (2, 2))]):
            rows.append(f"{number},-1,{left:.2f},{top:.2f},24,60,1,-1,-1,-1")
    path.write_text("\n".join(rows) + "\n")


def _run(folder: Path) -> dict[str, Any]:
    """One process, with a cache of its own in ``folder``."""
    options = ["track", "--detections", str(folder / "det.txt"), "--frame-size", "640x480", "--fps", "25"]
    out = ["--out", str(folder / "run"), "--overwrite"]
    # Bytecode is kept, as an installation has it, also where the shell forbids it: that work is no part of a start.
    environment = os.environ | {"NUMBA_CACHE_DIR": str(folder / "cache"), "PYTHONDONTWRITEBYTECODE": ""}
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
    print(f"{sum(found['kernels'].values()):8.2f} s  these {len(found['kernels'])}, each without those that it calls")
    print(f"{found['compile_s']:8.2f} s  all, with what helping processes compiled")
    print(f"first frame after {found['first_use_s']:.1f} s on first use, {found['start_s']:.2f} s from then on")


if __name__ == "__main__":
    main()
