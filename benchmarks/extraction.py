"""Milliseconds of one extraction, on the intensities of the fused filter at M07's parameters and
constant density; and of a frame's filter and extraction on one thread and on two.

python -m benchmarks.extraction
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from benchmarks.timing import Spread, in_turns, seconds
from benchmarks.workload import Crowd, draw, stages
from phdtrack.filters.extract import KMeans, Mixture
from phdtrack.protocols import AnyStages, Model
from phdtrack.types import F8, Estimates

EXTRACTORS: dict[str, KMeans | Mixture] = {"kmeans": KMeans(), "mixture": Mixture()}
WARM_UP = 12
REPEATS = 15


def intensities(targets: int, frames: int, seed: int = 1) -> list[tuple[Any, Any, Any]]:
    """Return intensity, measurements and model in the last ``frames`` frames of a crowd."""
    crowd = Crowd(targets, WARM_UP + frames)
    stream = draw(crowd, seed)
    built = stages(crowd)
    rng = np.random.default_rng(seed)
    state = built.filter.start(built.model, rng)
    out = []
    for number, found in enumerate(stream.detections()):
        z = built.model.sensor.measure(found)
        state, _ = built.filter.step(state, z, built.model, 1.0, rng)
        if number >= WARM_UP:
            out.append((state, z, built.model))
    return out


def measure(targets: int, kind: str = "kmeans", frames: int = 8, seed: int = 1) -> dict[str, float]:
    """Milliseconds an extraction (the least and the median over frames of the least of repeats),
    particles and states.
    """
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


def on_threads(
    targets: int, frames: int = 4, seed: int = 1, repeats: int = REPEATS
) -> dict[str, float | bool]:
    """Filter and extraction of a frame on one thread and on two, in turns.

    ``one_ms``, ``two_ms`` : medians over ``frames`` frames of the least of ``repeats``; ``ratio`` :
        of the one to the other;
    ``identical`` : whether the states are the same to the bit.
    """
    crowd = Crowd(targets, WARM_UP + frames)
    built = [stages(crowd, sets=(f"filter.threads={n}",)) for n in (1, 2)]
    least = []
    identical = True
    for state, z, model in intensities(targets, frames, seed):

        def frame(of: AnyStages, state: Any = state, z: F8 = z, model: Model = model) -> Estimates:
            after, _ = of.filter.step(state, z, model, 1.0, np.random.default_rng(seed))
            return of.extractor.extract(after, z, model)

        least.append(
            [times.min() for times in in_turns([partial(frame, of) for of in built], repeats)]
        )
        one, two = (frame(of) for of in built)
        identical &= all(
            np.array_equal(getattr(one, name), getattr(two, name))
            for name in ("state", "covariance", "weight")
        )
    one_ms, two_ms = np.median(1e3 * np.array(least), axis=0).tolist()
    return {"one_ms": one_ms, "two_ms": two_ms, "ratio": one_ms / two_ms, "identical": identical}


def main() -> None:
    """Print a line for each number of targets."""
    for targets in (10, 100, 1000):
        print("filter and extraction", targets, on_threads(targets), flush=True)
    for kind in EXTRACTORS:
        for targets in (10, 20, 100, 1000):
            print(
                kind, targets, measure(targets, kind, frames=4 if targets > 300 else 8), flush=True
            )


if __name__ == "__main__":
    main()
