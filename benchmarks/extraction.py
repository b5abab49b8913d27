"""Milliseconds of one extraction, on the intensities of the fused filter at M07's parameters and constant density.

python -m benchmarks.extraction
"""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.timing import Spread, seconds
from benchmarks.workload import Crowd, draw, stages
from phdtrack.extract import KMeans, Mixture

EXTRACTORS = {"kmeans": KMeans(), "mixture": Mixture()}
WARM_UP, REPEATS = 12, 15


def intensities(targets: int, frames: int, seed: int = 1) -> list[tuple[Any, Any, Any]]:
    """Of the last ``frames`` frames of a crowd: the filter's intensity, the measurements, the model."""
    crowd = Crowd(targets, WARM_UP + frames)
    stream, built = draw(crowd, seed), stages(crowd)
    rng = np.random.default_rng(seed)
    state, out = built.filter.start(built.model, rng), []
    for number, found in enumerate(stream.detections()):
        z = built.model.sensor.measure(found)
        state, _ = built.filter.step(state, z, built.model, 1.0, rng)
        if number >= WARM_UP:
            out.append((state, z, built.model))
    return out


def measure(targets: int, kind: str = "kmeans", frames: int = 8, seed: int = 1) -> dict[str, float]:
    """Milliseconds an extraction (the least and the median over frames of the least of repeats), particles and states."""
    extractor = EXTRACTORS[kind]
    cases = intensities(targets, frames, seed)
    least = [seconds(lambda case=case: extractor.extract(*case), REPEATS).min() for case in cases]
    spread = Spread.of(least, 1e3)
    return {
        "ms": spread.median,
        "ms_least": spread.least,
        "particles": float(np.mean([len(state) for state, _, _ in cases])),
        "states": float(np.mean([len(extractor.extract(*case)) for case in cases])),
    }


def main() -> None:
    """Print a line for each number of targets."""
    for kind in EXTRACTORS:
        for targets in (10, 20, 100, 1000):
            print(kind, targets, measure(targets, kind, frames=4 if targets > 300 else 8), flush=True)


if __name__ == "__main__":
    main()
