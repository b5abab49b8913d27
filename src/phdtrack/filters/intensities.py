"""States of filters besides particles and mixtures: an intensity with a cardinality distribution, joint samples."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np

from phdtrack.types import F8, I8, GaussianMixture, ParticleBlocks, Particles, Real


@dataclass(frozen=True, slots=True, eq=False)
class UpdatedParticles:
    """The updated intensity before it is resampled: the particles that were there, and the newborn."""

    old: ParticleBlocks
    born: ParticleBlocks

    def __len__(self) -> int:
        return len(self.old) + len(self.born)

    @property
    def mass(self) -> float:
        """The integral of the intensity: the expected number of targets."""
        return self.old.mass + self.born.mass

    @property
    def state(self) -> Real:
        """(d, L) states."""
        return np.concatenate([self.old.state, self.born.state], axis=1)

    @property
    def weight(self) -> F8:
        """(L,) weights."""
        return np.concatenate([self.old.weight, self.born.weight])

    def particles(self) -> Particles:
        """The same intensity as plain particles; a copy in float64."""
        return Particles(self.state.astype(np.float64), self.weight)


Points = TypeVar("Points", Particles, ParticleBlocks, UpdatedParticles, GaussianMixture)


@dataclass(frozen=True, slots=True, eq=False)
class Cardinalised(Generic[Points]):
    """An intensity with the distribution of the number of targets: what the cardinalised PHD filters carry.

    ``cardinality`` (n,) holds the probabilities of 0, 1, 2, … targets; its mean is the mass of ``intensity`` and of what may
    have been born where nothing was detected.
    """

    intensity: Points
    cardinality: F8

    def __len__(self) -> int:
        return len(self.intensity)

    @property
    def mass(self) -> float:
        """The integral of the intensity: the expected number of targets."""
        return self.intensity.mass


def parts(state: Any, *, counted: bool) -> tuple[Any, F8 | None]:
    """The intensity of a state, and the probabilities (n,) of 0, 1, 2, … targets if they are there and to be used."""
    if isinstance(state, Cardinalised):
        return state.intensity, state.cardinality if counted else None
    return state, None


@dataclass(frozen=True, slots=True, eq=False)
class JointSamples:
    """Samples of the joint state of labelled targets: what the MCMC filter carries.

    Sample s of the joint state is the s-th state of every target, of those that are there in it. The states of the others
    are where they would be; ``chance`` weighs all of them.

    Attributes
    ----------
    state : (d, n·N) the N states of each of n targets, those of a target beside each other.
    chance : (n, N) the probability that the target is there, given its state and the others' in that sample.
    label : (n,) int64 ascending, one for a target's life.
    fresh : the next new target's label: none that was ever given is as large.
    origin, interval : (d, n·N) the states that these were predicted from, and the time since; (d, 0) and 0 after an update.
    """

    state: F8
    chance: F8
    label: I8
    fresh: int
    origin: F8
    interval: float = 0.0

    @classmethod
    def empty(cls, dim: int, samples: int) -> JointSamples:
        """No targets of dimension ``dim``."""
        none = np.zeros((dim, 0))
        return cls(none, np.zeros((0, samples)), np.zeros(0, np.int64), 0, none)

    def __len__(self) -> int:
        return self.chance.size

    @property
    def weight(self) -> F8:
        """(n·N,) weights with which the states are the intensity."""
        weight: F8 = self.chance.ravel() / self.chance.shape[1]
        return weight

    @property
    def existence(self) -> F8:
        """(n,) the probability that each target is there."""
        mean: F8 = self.chance.mean(axis=1)
        return mean

    @property
    def mass(self) -> float:
        """The expected number of targets."""
        mass: float = self.chance.sum() / self.chance.shape[1]
        return mass
