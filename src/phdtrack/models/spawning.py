"""β(x|ξ): targets that come out of targets. The papers leave it out (β = 0); the term stays in the model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from phdtrack.checks import NonNegative, Probability, check
from phdtrack.types import F8, ParticleBlocks, Particles


class Spawn(Protocol):
    """The spawning part of a motion."""

    def sample(self, parents: Particles | ParticleBlocks, dt: float, rng: np.random.Generator) -> Particles:
        """Draws of ∫ β(x|ξ) D(ξ) dξ."""


@dataclass(frozen=True, slots=True)
class NoSpawn:
    """β = 0, as in all four papers."""

    def sample(self, parents: Particles | ParticleBlocks, dt: float, rng: np.random.Generator) -> Particles:
        """Nothing."""
        return Particles(np.zeros((len(parents.state), 0)), np.zeros(0))


@dataclass(frozen=True, slots=True)
class SplitSpawn:
    """Each target throws off new ones next to it, with its state displaced by a Gaussian.

    Parameters
    ----------
    rate : expected new targets of each target per time unit.
    distance : standard deviation of the displacement, in widths and heights of the parent.
    fraction : share of the parents that are drawn, which bounds the cost.
    """

    rate: NonNegative = 0.001
    distance: NonNegative = 0.5
    fraction: Probability = 0.1

    def __post_init__(self) -> None:
        check(self)

    def sample(self, parents: Particles | ParticleBlocks, dt: float, rng: np.random.Generator) -> Particles:
        """Draws of β(x|ξ) = rate·dt · N(x; ξ, distance² · size²) over the intensity ``parents``."""
        mass = self.rate * dt * parents.mass
        count = int(np.ceil(self.fraction * len(parents)))
        if count == 0 or mass <= 0:
            return Particles(np.zeros((len(parents.state), 0)), np.zeros(0))
        chosen = rng.choice(len(parents), size=count, p=parents.weight / parents.mass)
        state = parents.state[:, chosen].astype(np.float64)
        size: F8 = state[4:6]
        state[:2] += self.distance * size * rng.standard_normal((2, count))
        return Particles(state, np.full(count, mass / count))
