"""The GM-PHD filter for boxes: µs per step (predict, births, update, prune, merge, cap) and OSPA
against the truth.

    python -m benchmarks.gm_phd

The workload is `benchmarks.workload`'s, the model M09's for its density. Extraction is not part of
a step; OSPA is between the centres of the components of weight ≥ 0.5 and the true ones.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.loops import CUTOFF, TURN
from benchmarks.timing import Spread, clock, took
from benchmarks.workload import Crowd, Stream, draw, stages
from experiments.scans import ospa
from phdtrack.filters import GMPHD
from phdtrack.protocols import Filter, Model
from phdtrack.types import F8, GaussianMixture

REPEATS = 10
# From a filter's state to the positions (2, n) that it would report.
Points = Callable[[Any], F8]


def measure(targets: int, seed: int = 1, frames: int = 60) -> dict[str, Any]:
    """The GM-PHD filter's step, see `steps`."""
    crowd = Crowd(targets, frames)
    return steps(GMPHD(), stages(crowd).model, crowd, seed, _heavy)


def steps(
    recursion: Filter[Any], model: Model, crowd: Crowd, seed: int, points: Points
) -> dict[str, Any]:
    """Median µs per step over the second half of the frames and all repeats, with what was tracked.

    ``least`` is the median over the frames of each one's fastest repeat, ``cpu`` the median of the
    thread's processor time.
    """
    stream = draw(crowd, seed)
    frames = crowd.frames
    measured = [model.sensor.measure(found) for found in stream.detections()]
    spent = [_run(recursion, model, measured, None, points)[0] for _ in range(REPEATS)]
    wall, cpu = np.moveaxis(np.array(spent)[:, frames // 2 :], 2, 0)
    _, components, mass, distance = _run(recursion, model, measured, stream, points)
    return {
        "us": float(np.median(wall) * 1e6),
        "least": float(np.median(wall.min(axis=0)) * 1e6),
        "cpu": float(np.median(cpu) * 1e6),
        "spread": Spread.of(wall.ravel(), 1e6).as_dict(),
        "components": float(np.mean(components[frames // 2 :])),
        "detections": float(np.mean([z.shape[1] for z in measured])),
        "mass": float(np.mean(mass[frames // 2 :])),
        "ospa": float(np.mean(distance[len(distance) // 2 :])),
        "frames": frames,
        "seed": seed,
    }


def _run(
    recursion: Filter[Any], model: Model, measured: list[F8], stream: Stream | None, points: Points
) -> tuple[list[Any], ...]:
    """Seconds on the wall and of the processor, components and mass of every frame, and with the
    ``stream`` OSPA.
    """
    rng = np.random.default_rng(0)
    state = recursion.start(model, rng)
    spent = []
    components = []
    mass = []
    distance = []
    for number, z in enumerate(measured, start=1):
        began = clock()
        state, info = recursion.step(state, z, model, 1.0, rng)
        spent.append(took(began, clock()))
        components.append(float(len(state)))
        mass.append(info.mass)
        # The assignment of a thousand to a thousand is slow: a few frames tell.
        if stream is not None and (len(measured[number - 1][0]) < 600 or number % TURN == 0):
            distance.append(_ospa(points(state), stream, number))
    return spent, components, mass, distance


def _heavy(state: GaussianMixture) -> F8:
    """Positions (2, n) of the heavy components."""
    return state.mean[:2, state.weight >= 0.5]


def _ospa(found: F8, stream: Stream, number: int) -> float:
    """OSPA of order 1 of positions (2, n), pixels."""
    boxes = stream.truth_at(number)
    true = (boxes[:, :2] + boxes[:, 2:]).T / 2
    return ospa(found, true, CUTOFF)


def main() -> None:
    """One line for each number of targets."""
    print(f"{'targets':>8}{'µs':>9}{'components':>12}{'detections':>12}{'mass':>9}{'OSPA px':>9}")
    for targets in (10, 30, 100, 300, 1000):
        m = measure(targets)
        cells = f"{m['us']:9.1f}{m['components']:12.0f}{m['detections']:12.0f}"
        cells += f"{m['mass']:9.1f}{m['ospa']:9.2f}"
        print(f"{targets:8d}{cells}", flush=True)


if __name__ == "__main__":
    main()
