"""The association alone: microseconds per frame on a stream of states, as a filter gives them.

Boxes at constant density (10 per 720 × 480) move and turn, are missed in 5 % of the frames;
``clutter`` false states are added, by default one for every ten boxes.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from benchmarks.timing import Spread
from phdtrack import config
from phdtrack.protocols import AnyStages
from phdtrack.types import Detections, Estimates, SequenceInfo

RATE = 25.0
P_SEEN = 0.95
# Settling: until then the window is not full.
SETTLED = 60


def stream(
    stages: AnyStages, targets: int, frames: int, clutter: float, rng: np.random.Generator
) -> list[Estimates]:
    """The states of each frame, those of boxes with a velocity known to half a pixel, false ones
    without.
    """
    area = np.array([720.0, 480.0]) * (targets / 10) ** 0.5
    centre = rng.uniform(0, area, (targets, 2))
    width = rng.uniform(20, 50, targets)
    size = np.stack([width, 2 * width], axis=1)
    velocity = rng.normal(0, 0.02, (targets, 2)) * size
    out = []
    for _ in range(frames):
        centre = centre + velocity
        velocity = np.where(
            ((centre < 0) & (velocity < 0)) | ((centre > area) & (velocity > 0)),
            -velocity,
            velocity,
        )
        seen = rng.random(targets) < P_SEEN
        n = int(rng.poisson(clutter))
        stray = rng.uniform(20, 50, n)
        false = np.hstack([rng.uniform(0, area, (n, 2)), stray[:, None], 2 * stray[:, None]])
        true = np.hstack([centre + rng.normal(0, 0.02, centre.shape) * size, size])[seen]
        z = np.vstack([true, false]).T
        state, cov = stages.model.sensor.states(z)
        known = np.arange(int(seen.sum()))
        state[2:4, known] = velocity[seen].T
        cov[np.ix_(known, [2, 3])] = 0.0
        cov[known, 2, 2] = cov[known, 3, 3] = 0.25
        out.append(
            Estimates(
                state,
                cov,
                np.ones(z.shape[1]),
                stages.model.sensor.boxes(state),
                np.arange(z.shape[1]),
            )
        )
    return out


def measure(targets: int, frames: int = 0, seed: int = 1, clutter: float = -1.0) -> dict[str, Any]:
    """µs per `GraphMatching.extend` in the settled state: median, quartiles, least; and how large
    the window was.

    ``frames`` 0: 400 at 20 targets and fewer with more of them, 120 at least.
    """
    frames = frames or max(120, min(400, 20_000 // max(targets, 1)))
    rng = np.random.default_rng(seed)
    stages = config.build(
        config.load(sets=["filter.kind=particle-phd"]), SequenceInfo(720, 480, RATE)
    )
    matching = stages.associator
    model = stages.model
    state = matching.start()
    spent = []
    states = stream(stages, targets, frames, 0.1 * targets if clutter < 0 else clutter, rng)
    for number, estimates in enumerate(states, start=1):
        z = estimates.state[list(model.sensor.observed)]
        seen = Detections.of(estimates.xyxy)
        began = time.perf_counter()
        state, _ = matching.extend(state, estimates, z, seen, number, 1.0, model)
        spent.append(time.perf_counter() - began)
    settled = spent[min(SETTLED, frames // 2) :]
    sizes = {"targets": targets, "states": len(states[-1]), "window": len(state.window.since)}
    return Spread.of(settled, 1e6).as_dict() | sizes


if __name__ == "__main__":
    for number_of_targets in (10, 20, 200, 1000):
        print(measure(number_of_targets))
