"""No filter: the detections themselves are the states. M07's baseline MT, M09's DA (``--filter none``)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.protocols import Model
from phdtrack.types import F8, Particles, UpdateInfo


@dataclass(frozen=True, slots=True)
class NoFilter:
    """Each detection is a target of weight 1, at rest; nothing is remembered and nothing doubted."""

    def start(self, model: Model, rng: np.random.Generator) -> Particles:
        """Nothing."""
        return Particles(np.zeros((model.motion.dim, 0)), np.zeros(0))

    def predict(self, state: Particles, model: Model, dt: float, rng: np.random.Generator) -> Particles:
        """Nothing outlives its frame."""
        return self.start(model, rng)

    def update(
        self, state: Particles, z: F8, model: Model, dt: float, rng: np.random.Generator
    ) -> tuple[Particles, UpdateInfo]:
        """The states that would give the detections, weight 1 each."""
        n = z.shape[1]
        seen, _ = model.sensor.states(z)
        return Particles(seen, np.ones(n)), UpdateInfo(float(n), float(n), float(n), np.ones(n), np.zeros(n))

    def reduce(self, state: Particles, rng: np.random.Generator) -> Particles:
        """There is nothing to reduce."""
        return state

    def step(
        self, state: Particles, z: F8, model: Model, dt: float, rng: np.random.Generator
    ) -> tuple[Particles, UpdateInfo]:
        """Predict, update and reduce in turn."""
        return self.update(self.start(model, rng), z, model, dt, rng)
