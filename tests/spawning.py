"""A model of targets that come out of targets; the library ships none, as the papers leave it out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.types import Particles


@dataclass(frozen=True)
class Splitting:
    """Each target throws off ``rate`` new ones per time unit, where it is itself."""

    rate: float

    def sample(self, parents, dt: float, rng: np.random.Generator) -> Particles:
        n = len(parents) // 2
        chosen = rng.choice(len(parents), size=n, p=parents.weight / parents.mass)
        return Particles(parents.state[:, chosen].astype(np.float64), np.full(n, self.rate * dt * parents.mass / n))
