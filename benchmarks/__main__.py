"""Frames per second of filter, extraction and association at M07's parameters.

    python -m benchmarks

One process on one core: 1500 particles per target, 1000 newborn per detection, targets and clutter at constant density.
Writes benchmarks/out/bench.json and prints a table; milliseconds per frame are medians after a warm-up.
"""

from __future__ import annotations

import json
import os
import platform
import sys
from pathlib import Path

import numpy as np

from phdtrack import config, pipeline
from phdtrack.doctor import versions
from phdtrack.simulate import DetectorModel, make_scene

OUT = Path(__file__).resolve().parent / "out"
FRAMES, WARM_UP = 120, 20
# 10 targets and 10 clutter points per 720 × 480 area; the area grows with the targets.
AREA = (720, 480)


def measure(targets: int, preset: str, seed: int = 1) -> tuple[np.ndarray[tuple[int, int], np.dtype[np.float64]], float]:
    """(frames, 3) seconds of filter, extraction and association, and the mean number of particles."""
    grow = (targets / 10) ** 0.5
    detector = DetectorModel(p_detect=0.95, jitter=0.05, clutter_rate=float(targets))
    size = {"width": round(AREA[0] * grow), "height": round(AREA[1] * grow)}
    # Slow, steady targets that do not die: their number stays what the row says.
    world = {"n": targets, "frames": FRAMES, "sd_size": 0.0, "sd_velocity": 0.002, "birth_speed": 0.02, "p_survive": 1.0}
    world |= size
    scene = make_scene("constant", seed, detector, **world)
    info, table = scene.info, scene.detections
    stages = config.build(config.load(preset=preset), info)
    rng = np.random.default_rng(seed)
    state, spent, particles = pipeline.start(stages, rng), [], []
    for number in range(1, FRAMES + 1):
        state, step = pipeline.advance(stages, state, table.at(number), number, number / 25, rng)
        spent.append(step.seconds)
        particles.append(len(state.intensity))
    return np.array(spent)[WARM_UP:], float(np.mean(particles[WARM_UP:]))


def main() -> None:
    """Measure, print, write."""
    rows = []
    print(
        f"{'preset':8}{'targets':>8}{'particles':>11}{'filter ms':>11}{'extract ms':>12}{'associate ms':>14}{'frames/s':>10}"
    )
    for preset in ("m07", "m09", "default"):
        for targets in (10, 30, 100):
            seconds, particles = measure(targets, preset)
            stage = 1e3 * np.median(seconds, axis=0)
            total = 1e3 * float(np.median(seconds.sum(axis=1)))
            rows.append(
                {
                    "preset": preset,
                    "targets": targets,
                    "particles": particles,
                    "filter_ms": stage[0],
                    "extract_ms": stage[1],
                    "associate_ms": stage[2],
                    "frames_per_second": 1e3 / total,
                }
            )
            cells = (
                f"{preset:8}{targets:8d}{particles:11.0f}{stage[0]:11.2f}{stage[1]:12.2f}{stage[2]:14.2f}{1e3 / total:10.0f}"
            )
            print(cells, flush=True)
    OUT.mkdir(exist_ok=True)
    machine = {
        "processor": platform.processor() or platform.machine(),
        "cores": os.cpu_count(),
        "python": sys.version.split()[0],
    }
    document = {"machine": machine, "versions": dict(versions()), "frames": FRAMES - WARM_UP, "rows": rows}
    (OUT / "bench.json").write_text(json.dumps(document, indent=2) + "\n")
    print(OUT / "bench.json")


if __name__ == "__main__":
    main()
