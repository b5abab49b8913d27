"""Stages that record what they are asked: one target, no clutter, nothing random but the draws that are asked for."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from composed import composed_step
from phdtrack import config
from phdtrack.protocols import AnyStages, Stages
from phdtrack.types import Estimates, MeasurementHistory, SequenceInfo, Tracks, UpdateInfo

INFO = SequenceInfo(640, 480, 25.0)


@dataclass
class SpyFilter:
    """A filter whose state is the list of calls; each draws one number."""

    calls: list[tuple] = field(default_factory=list)

    def start(self, model, rng):
        return ()

    def predict(self, state, model, dt, rng):
        self.calls.append(("predict", dt))
        return Counted((*state, ("predict", dt)))

    def update(self, state, z, model, dt, rng):
        self.calls.append(("update", dt, z.shape))
        return Counted((*state, ("update", z.shape))), UpdateInfo(0.0, 0.0, 0.0, np.zeros(z.shape[1]), np.zeros(z.shape[1]))

    def reduce(self, state, rng):
        self.calls.append(("reduce",))
        return state

    def step(self, state, z, model, dt, rng):
        return composed_step(self, state, z, model, dt, rng)


class Counted(tuple):
    """A state with a mass."""

    mass = 0.0


@dataclass
class SpyExtractor:
    """Gives the measurements at rest, and remembers the states that it was shown."""

    seen: list = field(default_factory=list)

    def extract(self, state, z, model):
        self.seen.append(state)
        x, cov = model.sensor.states(z)
        return Estimates(x, cov, np.ones(len(cov)), model.sensor.boxes(x), np.arange(len(cov)))


@dataclass
class SpyAssociator:
    """Gives every state the identity 1 more than its place, and remembers the frames and intervals."""

    frames: list[tuple[int, float]] = field(default_factory=list)

    def start(self):
        return 0

    def extend(self, state, estimates, z, number, dt, model):
        self.frames.append((number, dt))
        n = len(estimates)
        rows = Tracks(
            np.full(n, number), 1 + np.arange(n), estimates.xyxy, np.ones(n), estimates.detection, np.ones(n, np.bool_)
        )
        return state + n, rows

    def flush(self, state, model):
        return Tracks.empty()

    def finish(self, state, model):
        return Tracks.empty()

    def measurements(self, state):
        none, start = np.zeros(0, np.int64), np.zeros(1, np.int64)
        return MeasurementHistory(none, np.zeros(0), start, np.zeros((4, 0)), np.zeros((0, 3, 3)))


def spying(rate: float = 25.0) -> tuple[AnyStages, SpyFilter, SpyExtractor, SpyAssociator]:
    model = config.build(config.load(sets=[f"time.units_per_second={rate}"]), INFO).model
    filter_, extractor, associator = SpyFilter(), SpyExtractor(), SpyAssociator()
    return Stages(model, filter_, extractor, associator), filter_, extractor, associator
