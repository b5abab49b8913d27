"""Measures the memory of one filter in a process of its own, started by `benchmarks.memory`; prints
JSON.

    python -m benchmarks.memory_process peak TARGETS
        peak of a step over the memory before it, and the number of particles
    python -m benchmarks.memory_process flat FRAMES
        resident memory along a sequence of 10 targets
    python -m benchmarks.memory_process tracker FRAMES
        the same of a whole `Tracker`

Linux tells both numbers: VmRSS, and VmHWM, its peak, which can be set back.
"""

from __future__ import annotations

import gc
import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.loops import Ours
from benchmarks.twins import NEWBORN
from benchmarks.workload import RATE, Crowd, draw, stages
from phdtrack import Tracker

WARM_UP = 8


def resident(what: str = "VmRSS") -> int:
    """Bytes of resident memory, or of its peak (VmHWM)."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(what):
            return int(line.split()[1]) * 1024
    raise OSError(f"the system does not tell {what}")


def peak(targets: int) -> dict[str, Any]:
    """Bytes per particle, old and newborn, that a step needs beyond what is there before the first
    frame.
    """
    frames = WARM_UP + 4
    small = Crowd(min(10, targets), frames)
    crowd = Crowd(targets, frames)
    warm = Ours(stages(small, worst=True), 1)
    for number, found in enumerate(draw(small, 1).detections(), start=1):
        warm.frame(number, found)
    detections = draw(crowd, 1).detections()
    gc.collect()
    before = resident()
    Path("/proc/self/clear_refs").write_text("5")
    out: dict[str, Any] = {"targets": targets, "before": before}
    loop = Ours(stages(crowd, worst=True), 1)
    most = 0
    model = loop.stages.model
    particle_filter = loop.stages.filter
    for found in detections:
        old = len(loop.state)
        loop.state, _ = particle_filter.step(
            loop.state, model.sensor.measure(found), model, 1.0, loop.rng
        )
        most = max(most, old + NEWBORN * len(found))
    out |= {"particles": most, "filter": (resident("VmHWM") - before) / most}
    for number, found in enumerate(detections, start=1):
        loop.frame(number, found)
    return out | {
        "filter_and_extraction": (resident("VmHWM") - before) / most,
        "peak": resident("VmHWM"),
    }


def flat(frames: int, whole: bool) -> dict[str, Any]:
    """Resident memory after a tenth of the frames and at the end, and the growth per frame
    between.
    """
    crowd = Crowd(10, min(frames, 500))
    detections = draw(crowd, 1).detections()
    loop = Ours(stages(crowd), 1)
    tracker = Tracker((crowd.info.width, crowd.info.height), fps=RATE)
    marks = []
    began = time.perf_counter()
    for number in range(frames):
        found = detections[number % len(detections)]
        if whole:
            tracker.update(found.xyxy)
        else:
            loop.frame(number + 1, found)
        if number % max(frames // 20, 1) == 0:
            marks.append(resident())
    marks.append(resident())
    after = marks[2:]
    slope = float(np.polyfit(np.linspace(0.1, 1, len(after)) * frames, after, 1)[0])
    grown = after[-1] - after[0]
    spent = time.perf_counter() - began
    return {
        "frames": frames,
        "resident": marks,
        "grown": grown,
        "bytes_per_frame": slope,
        "seconds": spent,
    }


def main() -> None:
    """Measure what the arguments say."""
    what = sys.argv[1]
    number = int(sys.argv[2])
    result = peak(number) if what == "peak" else flat(number, what == "tracker")
    print(json.dumps(result))


if __name__ == "__main__":
    main()
