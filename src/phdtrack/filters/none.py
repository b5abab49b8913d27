"""No filter: the detections themselves are the states. M07's baseline MT, M09's DA (``--filter
none``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.protocols import Filter, Model
from phdtrack.types import F8, Estimates, Particles, UpdateInfo


@dataclass(frozen=True, slots=True)
class NoFilter(Filter[Particles]):
    """Each detection is a target of weight 1, at rest; nothing is remembered and nothing
    doubted.
    """

    def start(self, model: Model, rng: np.random.Generator) -> Particles:
        """Nothing."""
        return Particles(np.zeros((model.motion.dim, 0)), np.zeros(0))

    def predict(
        self, state: Particles, model: Model, dt: float, rng: np.random.Generator
    ) -> Particles:
        """Nothing outlives its frame."""
        return self.start(model, rng)

    def update(
        self, state: Particles, z: F8, model: Model, dt: float, rng: np.random.Generator
    ) -> tuple[Particles, UpdateInfo]:
        """The states that would give the detections, weight 1 each."""
        n = z.shape[1]
        mass = float(n)
        one = np.ones(n)
        zero = np.zeros(n)
        return Particles(model.sensor.states(z)[0], one), UpdateInfo(
            mass, mass, mass, one, zero, zero
        )


@dataclass(frozen=True, slots=True)
class Raw:
    """One state per detection, with the covariance of what one detection shows."""

    def extract(self, state: Particles, z: F8, model: Model) -> Estimates:
        """The detections as states at rest."""
        x, cov = model.sensor.states(z)
        return Estimates(x, cov, np.ones(len(cov)), model.sensor.boxes(x), np.arange(len(cov)))
